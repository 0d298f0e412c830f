"""What a disk may hold after the power went: files rebuilt from recorded operations, as far as nothing forbids it.

    everything(operations)                            # what the files are without a power failure
    survivors(operations, random)                     # one state that a power failure here may leave
    write_tree(state, folder)

The rules are the weakest that programs may rely on. A file's bytes are safe once the file was synchronised after they
were written; before that, each write may have reached the disk, or not, or some of its 512-byte sectors. A name
(created, renamed, removed) is safe once its folder was synchronised; before that, the latest changes of a folder may be
missing, in any number. What was safe stays.
"""

from __future__ import annotations

import random as rng
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath

from benchmarks.reliability.tracing import Operation

_SECTOR = 512
_ROOT = 0

Tree = Mapping[str, bytes | None]
"""Files by path, with their bytes; None for a folder."""


@dataclass
class _File:
    """A file's or folder's history: changes (write, truncate; or names), and how many of them are safe."""

    changes: list[Operation] = field(default_factory=list)
    safe: int = 0
    is_folder: bool = False


class _History:
    """All files by inode, and where they stand now."""

    def __init__(self, operations: Sequence[Operation]) -> None:
        self.files: dict[int, _File] = {_ROOT: _File(is_folder=True)}
        self._inodes: dict[str, int] = {".": _ROOT}
        for operation in operations:
            self._take(operation)

    def _take(self, operation: Operation) -> None:
        match operation.kind:
            case "create" | "folder":
                self.files[operation.inode] = _File(is_folder=operation.kind == "folder")
                self._inodes[operation.path] = operation.inode
                self._name(operation)
            case "write" | "truncate":
                self.files[operation.inode].changes.append(operation)
            case "sync":
                file = self.files[self._inodes[operation.path]]
                file.safe = len(file.changes)
            case "unlink" | "rmdir":
                self._inodes.pop(operation.path)
                self._name(operation)
            case "rename":
                for path in [each for each in self._inodes if each == operation.path or _is_in(each, operation.path)]:
                    self._inodes[operation.target + path.removeprefix(operation.path)] = self._inodes.pop(path)
                self._name(operation)

    def _name(self, operation: Operation) -> None:
        """Note a change of names with the folder that it belongs to."""
        above = str(PurePosixPath(operation.path).parent)
        if operation.kind == "rename" and above != str(PurePosixPath(operation.target).parent):
            raise AssertionError(f"a rename from folder to folder is not modelled: {operation}")
        self.files[self._inodes[above]].changes.append(operation)


def everything(operations: Sequence[Operation]) -> Tree:
    """Return the files after all operations, with nothing lost."""
    return _tree(_History(operations), None)


def survivors(operations: Sequence[Operation], random: rng.Random) -> Tree:
    """Return one state, drawn by `random`, in which a power failure after `operations` may leave the files."""
    return _tree(_History(operations), random)


def renamed_before_safe(operations: Sequence[Operation]) -> Iterator[str]:
    """Yield a sentence for every file that got its name while some of its bytes were not safe."""
    for number, operation in enumerate(operations):
        if operation.kind == "rename":
            history = _History(operations[:number])
            file = history.files.get(operation.inode)
            if file is not None and not file.is_folder and file.safe < len(file.changes):
                yield f"{operation.target} got its name before its bytes were synchronised"


def write_tree(tree: Tree, folder: Path) -> None:
    """Write the files into the existing `folder`."""
    for path, data in sorted(tree.items()):
        if data is None:
            (folder / path).mkdir(parents=True, exist_ok=True)
        else:
            (folder / path).parent.mkdir(parents=True, exist_ok=True)
            (folder / path).write_bytes(data)


def _tree(history: _History, random: rng.Random | None) -> Tree:
    tree: dict[str, bytes | None] = {}
    _grow(tree, history, _ROOT, "", random)
    return tree


def _grow(tree: dict[str, bytes | None], history: _History, inode: int, path: str, random: rng.Random | None) -> None:
    file = history.files[inode]
    if not file.is_folder:
        tree[path] = _bytes(file, random)
        return
    if path:
        tree[path] = None
    for name, child in _names(file, random).items():
        _grow(tree, history, child, f"{path}/{name}" if path else name, random)


def _names(folder: _File, random: rng.Random | None) -> Mapping[str, int]:
    """Return what a folder holds, name to inode: what is safe, and so many of its latest changes."""
    kept = len(folder.changes) if random is None else random.randint(folder.safe, len(folder.changes))
    names: dict[str, int] = {}
    for change in folder.changes[:kept]:
        name = PurePosixPath(change.path).name
        match change.kind:
            case "create" | "folder":
                names[name] = change.inode
            case "rename":
                names.pop(name, None)
                names[PurePosixPath(change.target).name] = change.inode
            case _:
                names.pop(name, None)
    return names


def _bytes(file: _File, random: rng.Random | None) -> bytes:
    """Return a file's bytes: all that is safe, and of each later change all, nothing or some sectors."""
    data = bytearray()
    for number, change in enumerate(file.changes):
        fate = "whole" if random is None or number < file.safe else random.choice(("whole", "lost", "torn"))
        if fate == "lost" or (fate == "torn" and change.kind == "truncate"):
            continue
        if change.kind == "truncate":
            del data[change.offset :]
            data.extend(bytes(change.offset - len(data)))
        elif random is None or fate == "whole":
            _put(data, change.offset, change.data)
        else:
            for begins in range(0, len(change.data), _SECTOR):
                if random.random() < 0.5:
                    _put(data, change.offset + begins, change.data[begins : begins + _SECTOR])
    return bytes(data)


def _put(data: bytearray, offset: int, piece: bytes) -> None:
    data.extend(bytes(max(0, offset - len(data))))
    data[offset : offset + len(piece)] = piece


def _is_in(path: str, folder: str) -> bool:
    return path.startswith(f"{folder}/")
