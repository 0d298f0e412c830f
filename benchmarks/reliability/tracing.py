"""Every system call by which a process changes files, seen from outside: recorded, counted, and a place to kill.

    trace = traced(work, root)                 # run work() in a child; trace.operations says what it did below root
    traced(work, root, kill_at=17)             # the same, killed with SIGKILL just before its 17th operation

The child is a fork under `ptrace`. A seccomp filter stops it at the calls that can change a file, and at nothing else,
so that a night costs hardly more than without. Nothing here knows what a night writes: whatever reaches the kernel is a
kill point. That nothing was missed is shown by `power.replayed`: all operations together give the folder as it is.
Linux on x86-64 or 64-bit ARM. Nothing in the calling process may run in other threads.
"""

from __future__ import annotations

import ctypes
import os
import platform
import signal
import struct
import sys
import traceback
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

_CALLS = {
    "x86_64": {
        "write": 1, "pwrite64": 18, "writev": 20, "pwritev": 296, "pwritev2": 328, "open": 2, "openat": 257,
        "openat2": 437, "creat": 85, "fsync": 74, "fdatasync": 75, "sync_file_range": 277, "msync": 26, "truncate": 76,
        "ftruncate": 77, "rename": 82, "renameat": 264, "renameat2": 316, "mkdir": 83, "mkdirat": 258, "rmdir": 84,
        "unlink": 87, "unlinkat": 263, "link": 86, "linkat": 265, "symlink": 88, "symlinkat": 266, "fallocate": 285,
        "sendfile": 40, "copy_file_range": 326, "splice": 275, "io_uring_enter": 426,
    },
    "aarch64": {
        "write": 64, "pwrite64": 68, "writev": 66, "pwritev": 70, "pwritev2": 287, "openat": 56, "openat2": 437,
        "fsync": 82, "fdatasync": 83, "sync_file_range": 84, "msync": 227, "truncate": 45, "ftruncate": 46,
        "renameat": 38, "renameat2": 276, "mkdirat": 34, "unlinkat": 35, "linkat": 37, "symlinkat": 36,
        "fallocate": 47, "sendfile": 71, "copy_file_range": 285, "splice": 76, "io_uring_enter": 426,
    },
}  # fmt: skip

_TRACEME, _CONT, _SETOPTIONS, _SYSCALL_INFO = 0, 7, 0x4200, 0x420E
_OPTIONS = 0x80 | 0x08 | 0x100000  # stop at seccomp, follow threads, kill the child with its tracer
_SECCOMP_STOP, _CLONE_STOP = 7, 3
_ANY_CHILD = 0x40000000  # __WALL: threads too
_NO_NEW_PRIVILEGES, _SET_SECCOMP, _FILTER = 38, 22, 2
_LOAD_NUMBER, _IF_EQUAL, _RETURN = 0x20, 0x15, 0x06
_TRACE, _ALLOW = 0x7FF00000, 0x7FFF0000
_HERE = -100  # AT_FDCWD
_REMOVE_FOLDER = 0x200  # AT_REMOVEDIR


class NotTraceable(Exception):
    """This system does not let a process trace its child."""


@dataclass(frozen=True)
class Operation:
    """One change to a file or folder below the root; paths are relative to it.

    `kind` is create, folder, write, truncate, sync, rename, unlink or rmdir. `inode` tells files of one name apart.
    """

    kind: str
    path: str
    target: str = ""
    offset: int = 0
    data: bytes = b""
    inode: int = 0

    def __str__(self) -> str:
        size = f" {len(self.data)} bytes at {self.offset}" if self.kind == "write" else ""
        return f"{self.kind} {self.path}{f' to {self.target}' if self.target else ''}{size}"


@dataclass
class Trace:
    """What a child did, and how it ended: its exit status, or -9 where it was killed."""

    operations: list[Operation] = field(default_factory=list)
    status: int = 0


class _Instruction(ctypes.Structure):
    _fields_ = (
        ("code", ctypes.c_uint16),
        ("if_true", ctypes.c_uint8),
        ("if_false", ctypes.c_uint8),
        ("value", ctypes.c_uint32),
    )


class _Program(ctypes.Structure):
    _fields_ = (("length", ctypes.c_uint16), ("instructions", ctypes.POINTER(_Instruction)))


_libc = ctypes.CDLL(None, use_errno=True)
_libc.ptrace.restype = ctypes.c_long
_libc.ptrace.argtypes = (ctypes.c_long, ctypes.c_long, ctypes.c_void_p, ctypes.c_void_p)
_libc.prctl.argtypes = (ctypes.c_int, ctypes.c_ulong, ctypes.c_void_p, ctypes.c_ulong, ctypes.c_ulong)


def traceable() -> bool:
    """Tell whether a child can be traced here."""
    if sys.platform != "linux" or platform.machine() not in _CALLS:
        return False
    try:
        return traced(lambda: 0, Path("/nowhere")).status == 0
    except NotTraceable:
        return False


def traced(work: Callable[[], int], root: Path, *, kill_at: int | None = None) -> Trace:
    """Run `work` in a child and return what it did below `root`; its return value is the exit status.

    With `kill_at` the child is killed with SIGKILL before its operation of that number (the first is 0) takes place.
    Raises `NotTraceable` where the system forbids it.
    """
    calls = {number: name for name, number in _CALLS[platform.machine()].items()}
    sys.stdout.flush()
    child = os.fork()
    if child == 0:
        _be_traced(tuple(calls), work)
    _, status = os.waitpid(child, _ANY_CHILD)
    if not os.WIFSTOPPED(status):
        raise NotTraceable("the system forbids ptrace or seccomp")
    _request(_SETOPTIONS, child, 0, _OPTIONS)
    _request(_CONT, child, 0, 0)
    return _Follower(child, calls, root, kill_at).follow()


def _be_traced(numbers: tuple[int, ...], work: Callable[[], int]) -> None:
    """Let the parent trace this child, run `work` and end. Never returns."""
    status = 70
    try:
        code = [_Instruction(_LOAD_NUMBER, 0, 0, 0)]
        code += [_Instruction(_IF_EQUAL, len(numbers) - i, 0, number) for i, number in enumerate(numbers)]
        code += [_Instruction(_RETURN, 0, 0, _ALLOW), _Instruction(_RETURN, 0, 0, _TRACE)]
        table = (_Instruction * len(code))(*code)
        program = _Program(len(code), table)
        if _libc.ptrace(_TRACEME, 0, None, None) != 0:
            os._exit(status)
        os.kill(os.getpid(), signal.SIGSTOP)
        if _libc.prctl(_NO_NEW_PRIVILEGES, 1, None, 0, 0) != 0:
            os._exit(status)
        if _libc.prctl(_SET_SECCOMP, _FILTER, ctypes.addressof(program), 0, 0) != 0:
            os._exit(status)
        status = work()
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stderr.flush()
        os._exit(status)


def _request(request: int, pid: int, address: int, data: int) -> int:
    result = int(_libc.ptrace(request, pid, address, data))
    if result < 0:
        raise NotTraceable(f"ptrace: {os.strerror(ctypes.get_errno())}")
    return result


class _Follower:
    """Follows one child from stop to stop."""

    def __init__(self, child: int, calls: dict[int, str], root: Path, kill_at: int | None) -> None:
        self._child = child
        self._calls = calls
        self._root = str(root)
        self._kill_at = kill_at
        self._trace = Trace()
        self._info = ctypes.create_string_buffer(96)
        self._inodes: dict[str, int] = {}
        self._made = 0

    def follow(self) -> Trace:
        while True:
            pid, status = os.waitpid(-1, _ANY_CHILD)
            if not os.WIFSTOPPED(status):
                if pid == self._child:
                    self._trace.status = os.waitstatus_to_exitcode(status)
                    return self._trace
                continue  # a thread has ended
            event, passed_on = status >> 16, 0
            if event == _SECCOMP_STOP:
                for operation in self._operations(pid):
                    if self._kill_at == len(self._trace.operations):
                        os.kill(self._child, signal.SIGKILL)
                    self._trace.operations.append(operation)
            elif event == 0 and os.WSTOPSIG(status) not in (signal.SIGSTOP, signal.SIGTRAP):
                passed_on = os.WSTOPSIG(status)
            if self._kill_at is None or len(self._trace.operations) <= self._kill_at:
                _request(_CONT, pid, 0, passed_on)

    def _operations(self, pid: int) -> list[Operation]:
        """Return what the call does at which `pid` stands: one operation, or none where it changes nothing here."""
        size = _request(_SYSCALL_INFO, pid, len(self._info), ctypes.addressof(self._info))
        number, *arguments = struct.unpack_from("<Q6q", self._info.raw[:size], 24)
        name = self._calls.get(number, "")
        found = self._changed(pid, name, arguments)
        return [] if found is None else [found]

    def _changed(self, pid: int, name: str, a: list[int]) -> Operation | None:
        match name:
            case "open":
                return self._opened(self._path(pid, _HERE, a[0]), a[1])
            case "openat":
                return self._opened(self._path(pid, a[0], a[1]), a[2])
            case "creat":
                return self._opened(self._path(pid, _HERE, a[0]), os.O_CREAT | os.O_TRUNC)
            case "write" | "pwrite64" if (path := self._of(pid, a[0])) is not None:
                offset = a[3] if name == "pwrite64" else self._offset(pid, a[0])
                data = self._memory(pid, a[1], a[2])
                return Operation("write", path, offset=offset, data=data, inode=self._inode(path))
            case "fsync" | "fdatasync" if (path := self._of(pid, a[0])) is not None:
                return Operation("sync", path, inode=self._inode(path))
            case "ftruncate" if (path := self._of(pid, a[0])) is not None:
                return Operation("truncate", path, offset=a[1], inode=self._inode(path))
            case "mkdir" | "mkdirat":
                path = self._below(self._path(pid, *((_HERE, a[0]) if name == "mkdir" else a[:2])))
                if path is not None and not os.path.lexists(f"{self._root}/{path}"):
                    return Operation("folder", path, inode=self._inode(path, new=True))
            case "unlink" | "unlinkat" | "rmdir":
                path = self._below(self._path(pid, *(a[:2] if name == "unlinkat" else (_HERE, a[0]))))
                if path is not None and os.path.lexists(f"{self._root}/{path}"):
                    folder = name == "rmdir" or (name == "unlinkat" and a[2] & _REMOVE_FOLDER)
                    if folder and os.listdir(f"{self._root}/{path}"):
                        return None  # will be refused
                    return Operation("rmdir" if folder else "unlink", path, inode=self._inodes.pop(path, 0))
            case "rename" | "renameat" | "renameat2":
                old, new = ((_HERE, a[0]), (_HERE, a[1])) if name == "rename" else ((a[0], a[1]), (a[2], a[3]))
                return self._renamed(self._below(self._path(pid, *old)), self._below(self._path(pid, *new)))
            case _ if name not in ("write", "pwrite64", "fsync", "fdatasync", "ftruncate", "msync"):
                self._unknown(pid, name, a)
        return None

    def _opened(self, absolute: str, flags: int) -> Operation | None:
        path = self._below(absolute)
        if path is None:
            return None
        there = os.path.lexists(absolute)
        if not there and flags & os.O_CREAT:
            return Operation("create", path, inode=self._inode(path, new=True))
        if there and flags & os.O_TRUNC:
            return Operation("truncate", path, inode=self._inode(path))
        return None

    def _renamed(self, old: str | None, new: str | None) -> Operation | None:
        if old is None and new is None:
            return None
        if old is None or new is None:
            raise AssertionError(f"a rename across the root: {old} to {new}")
        inode = self._inodes.pop(old, 0)
        for path in [each for each in self._inodes if each.startswith(f"{old}/")]:
            self._inodes[new + path.removeprefix(old)] = self._inodes.pop(path)
        self._inodes[new] = inode
        return Operation("rename", old, target=new, inode=inode)

    def _unknown(self, pid: int, name: str, a: list[int]) -> None:
        """Fail for a call that may change files in a way that is not recorded."""
        if any(self._of(pid, number) is not None for number in a[:3] if 0 <= number < 4096):
            raise AssertionError(f"{name} changes a file below the root, and is not recorded")

    def _inode(self, path: str, *, new: bool = False) -> int:
        if new or path not in self._inodes:
            self._made += 1
            self._inodes[path] = self._made
        return self._inodes[path]

    def _below(self, absolute: str) -> str | None:
        return os.path.relpath(absolute, self._root) if absolute.startswith(f"{self._root}/") else None

    def _path(self, pid: int, folder: int, address: int) -> str:
        """Return the absolute path that a call names."""
        with open(f"/proc/{pid}/mem", "rb", buffering=0) as memory:
            memory.seek(address)
            text = os.fsdecode(memory.read(4096).split(b"\0", 1)[0])
        if folder > 0x7FFFFFFF:
            folder -= 1 << 32
        above = f"/proc/{pid}/cwd" if folder == _HERE else f"/proc/{pid}/fd/{folder}"
        return os.path.normpath(text if text.startswith("/") else os.path.join(os.readlink(above), text))

    def _of(self, pid: int, descriptor: int) -> str | None:
        """Return the path of an open file or folder below the root, None for any other."""
        try:
            absolute = os.readlink(f"/proc/{pid}/fd/{descriptor}")
        except OSError:
            return None
        if absolute == self._root:
            return "."
        return None if absolute.endswith(" (deleted)") else self._below(absolute)

    def _offset(self, pid: int, descriptor: int) -> int:
        facts = dict(line.split(":", 1) for line in Path(f"/proc/{pid}/fdinfo/{descriptor}").read_text().splitlines())
        if int(facts["flags"], 8) & os.O_APPEND:
            return Path(f"/proc/{pid}/fd/{descriptor}").stat().st_size
        return int(facts["pos"])

    def _memory(self, pid: int, address: int, size: int) -> bytes:
        with open(f"/proc/{pid}/mem", "rb", buffering=0) as memory:
            memory.seek(address)
            return memory.read(size)
