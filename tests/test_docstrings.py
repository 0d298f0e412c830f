"""Docstrings say what cannot be seen from a signature: the shape of an array, and the exceptions a caller may meet.

Each says it once: a method that carries out one of a base class or a protocol needs none of its own.

A shape is a tuple, such as (n,), (n, 3) or (..., 6). An exception is called by the name of its class or of one that it
derives from, as in "Raises `InputError` where …"; those that a file's private functions raise are their callers' too.
Pydocstyle has no rule for either; those of numpydoc and ruff want sections, and this house writes prose: so the source
is read here, by its syntax alone.
"""

from __future__ import annotations

import ast
import builtins
import re
from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import pytest

from hil.cli.app import app

_ROOT = Path(__file__).resolve().parents[1]
_FLOORS = ("hil", "procedures", "drivers")

_SIZE = r"(?:\.\.\.|…|(?:\d*[a-zNS](?:'|_[a-z])?|\d+)(?: ?[·+−-] ?(?:\d*[a-zNS]|\d+))*)"
_NAMED = rf"(?:{_SIZE}|[a-z]+)"
_SHAPE = re.compile(
    rf"\({_NAMED},\)|\((?:{_NAMED}, )*{_SIZE}(?:, {_NAMED})+\)|\((?:{_NAMED}, )+{_SIZE}\)|\bshape \(|\bany shape\b"
)
"""A size is a number, a letter, a product or sum of these, or "..."; a word may stand beside it: (n, channels)."""

_CONSTRUCTORS = {"__init__", "__post_init__", "__call__"}
_EVERYTHING = {"Exception", "BaseException", "object"}

Function = ast.FunctionDef | ast.AsyncFunctionDef
Definition = Function | ast.ClassDef


@dataclass(frozen=True)
class _Scope:
    """A definition with the file and the class that it stands in."""

    path: str
    node: Definition
    owner: ast.ClassDef | None = None

    def complain(self, of: str) -> str:
        name = self.node.name if self.owner is None else f"{self.owner.name}.{self.node.name}"
        return f"{self.path}:{self.node.lineno}: {name} {of}"


class Source:
    """Files by their paths: what is public in them, and what docstrings leave out. `commands` are by file and name."""

    def __init__(self, files: dict[str, str], commands: Collection[tuple[str, str]] = ()) -> None:
        self._commands = commands
        self._trees = {path: ast.parse(text) for path, text in files.items()}
        self._classes: dict[str, list[ast.ClassDef]] = defaultdict(list)
        self._makers: dict[str, set[str]] = defaultdict(set)  # by the name of a function: the classes it returns
        for tree in self._trees.values():
            for node in ast.walk(tree):
                if isinstance(node, ast.ClassDef):
                    self._classes[node.name].append(node)
                elif isinstance(node, Function) and isinstance(node.returns, ast.Name):
                    self._makers[node.name].add(node.returns.id)
        self._arrays = {path: {"NDArray", "ndarray"} for path in files}  # what arrays are called in each file
        while sum(map(self._learn_aliases, files)):
            pass

    def without_shape(self) -> list[str]:
        """Return a complaint for each definition that takes, returns or holds arrays and gives no shape."""
        return [
            scope.complain("gives no shape, such as (n,), of its arrays")
            for scope in self.with_arrays()
            if not _SHAPE.search(self._said(scope))
        ]

    def without_exception(self) -> list[str]:
        """Return a complaint for each exception that leaves a function and is not in its docstring."""
        return [
            scope.complain(f"raises {name} and does not say so")
            for scope, names in self.raising
            for name in sorted(names)
            if self._ancestry(name).isdisjoint(re.findall(r"\w+", self._said(scope)))
        ]

    def without_docstring(self) -> list[str]:
        """Return a complaint for each method that neither has a docstring nor carries out one that has."""
        return [
            scope.complain("has no docstring, nor has a method that it carries out")
            for scope in self._public()
            if scope.owner and not scope.node.name.startswith("_") and not self._documented(scope)
        ]

    def with_arrays(self) -> Iterator[_Scope]:
        """Find the public definitions with an array in their signature or fields."""
        for scope in self._public():
            if any(self._has_array(scope.path, each) for each in _annotations(scope.node)):
                yield scope

    @cached_property
    def raising(self) -> list[tuple[_Scope, set[str]]]:
        """The public functions that raise, with what leaves them. Commands are left out.

        The docstring of a command is its page of help, and what it raises becomes its exit status; an exception with a
        private name is caught where it is known.
        """
        found = []
        for scope in self._public():
            if isinstance(scope.node, Function) and (scope.path, scope.node.name) not in self._commands:
                names = {name for name in self._raised(scope, scope.node.body) if not name.startswith("_")}
                found += [(scope, names)] if names else []
        return found

    def _public(self) -> Iterator[_Scope]:
        for path, tree in self._trees.items():
            if any(part.startswith("_") and part != "__init__.py" for part in Path(path).parts):
                continue
            scopes = [_Scope(path, node) for node in tree.body if isinstance(node, Definition)]
            for scope in scopes:
                if scope.node.name.startswith("_") and scope.node.name not in _CONSTRUCTORS:
                    continue
                yield scope
                if isinstance(scope.node, ast.ClassDef):
                    inside = (node for node in scope.node.body if isinstance(node, Definition))
                    scopes += [_Scope(path, node, scope.node) for node in inside]

    def _documented(self, scope: _Scope) -> bool:
        lineage = self._lineage(scope.owner) if scope.owner else []
        alike = (node for kind in lineage for node in kind.body if isinstance(node, Definition))
        return any(ast.get_docstring(node) for node in alike if node.name == scope.node.name)

    def _said(self, scope: _Scope) -> str:
        """Return all docstrings that speak for a definition: its own, its class's, and those that it inherits."""
        said = [ast.get_docstring(scope.node)]
        for kind in self._lineage(scope.owner or scope.node):
            said.append(ast.get_docstring(kind))
            for node in kind.body:
                if isinstance(node, ast.Expr):
                    said.append(_text(node.value))  # what stands under a field
                elif isinstance(node, Function) and scope.owner and node.name == scope.node.name:
                    said.append(ast.get_docstring(node))
        return " ".join(" ".join(filter(None, said)).split())

    def _lineage(self, node: Definition) -> list[ast.ClassDef]:
        """Return a class and what it inherits from or, by its docstring, is: "A `Transport` whose far end is …"."""
        lineage = [node] if isinstance(node, ast.ClassDef) else []
        for kind in lineage:
            promised = re.findall(r"`(?:\w+\.)*(\w+)`", ast.get_docstring(kind) or "")
            protocols = [each for name in promised for each in self._classes[name] if _is_protocol(each)]
            inherited = [each for base in map(_last, kind.bases) for each in self._classes[base]]
            lineage += [each for each in dict.fromkeys(inherited + protocols) if each not in lineage]
        return lineage

    def _ancestry(self, name: str) -> set[str]:
        """Return the name of an exception and the names of what it derives from."""
        lineage = [kind for one in self._classes[name] for kind in self._lineage(one)]
        names = {name, *(kind.name for kind in lineage), *(_last(base) for kind in lineage for base in kind.bases)}
        known = [getattr(builtins, each) for each in names if hasattr(builtins, each)]
        return (names | {kind.__name__ for one in known for kind in one.__mro__}) - _EVERYTHING

    def _raised(
        self,
        scope: _Scope,
        body: Iterable[ast.AST],
        caught: frozenset[str] = frozenset(),
        seen: tuple[ast.AST, ...] = (),
    ) -> Iterator[str]:
        """Find what is raised and not caught, here and in private functions that are called from here."""
        for node in body:
            if isinstance(node, Definition | ast.Lambda):
                continue  # it has callers of its own
            within: Iterable[ast.AST] = ast.iter_child_nodes(node)
            held = caught
            if isinstance(node, ast.Raise) and node.exc is not None:
                kinds = self._kinds(node.exc)
                yield from (name for name in kinds if caught.isdisjoint(self._ancestry(name) | _EVERYTHING))
            elif isinstance(node, ast.Try):
                types = [_names(each.type) if each.type else ["Exception"] for each in node.handlers]
                yield from self._raised(scope, node.body, caught.union(*types), seen)
                within = [*node.handlers, *node.orelse, *node.finalbody]
            elif isinstance(node, ast.With):
                calls = [item.context_expr for item in node.items if isinstance(item.context_expr, ast.Call)]
                held = caught.union(*(_names(call) for call in calls if _last(call.func) == "suppress"))
            elif isinstance(node, ast.Call) and (called := self._private(scope, node.func)) and called.node not in seen:
                yield from self._raised(called, called.node.body, caught, (*seen, called.node))
            yield from self._raised(scope, within, held, seen)

    def _kinds(self, raised: ast.expr) -> set[str]:
        """Return the class that is raised, or those that the function which makes the exception returns."""
        name = _last(raised.func if isinstance(raised, ast.Call) else raised)
        return {name} if name in self._classes or hasattr(builtins, name) else self._makers[name]

    def _private(self, scope: _Scope, called: ast.expr) -> _Scope | None:
        """Return the private function or method that is called, where it is this file's or this class's own."""
        name = _last(called)
        if not name.startswith("_"):
            return None
        if isinstance(called, ast.Name):
            scope, among = _Scope(scope.path, scope.node), self._trees[scope.path].body
        elif scope.owner and isinstance(called, ast.Attribute) and _last(called.value) in ("self", "cls"):
            among = [node for kind in self._lineage(scope.owner) for node in kind.body]
        else:
            return None
        found = (node for node in among if isinstance(node, Function) and node.name == name)
        return next((replace(scope, node=node) for node in found), None)

    def _learn_aliases(self, path: str) -> int:
        """Add the names, such as FloatArray, that a file gives to types with an array in them, or imports."""
        known, before = self._arrays[path], len(self._arrays[path])
        for node in self._trees[path].body:
            if isinstance(node, ast.Assign) and isinstance(node.value, ast.Subscript | ast.BinOp):
                known.update(map(_last, node.targets) if self._has_array(path, node.value) else ())
            for one in ast.walk(node) if isinstance(node, ast.If) else (node,):  # if TYPE_CHECKING
                if isinstance(one, ast.ImportFrom) and one.module:
                    module = one.module.replace(".", "/")
                    theirs = self._arrays.get(f"{module}.py") or self._arrays.get(f"{module}/__init__.py") or set()
                    known.update(each.asname or each.name for each in one.names if each.name in theirs)
        return len(known) - before

    def _has_array(self, path: str, annotation: ast.expr | None) -> bool:
        return annotation is not None and not self._arrays[path].isdisjoint(_names(annotation))


def _text(node: ast.expr) -> str:
    return node.value if isinstance(node, ast.Constant) and isinstance(node.value, str) else ""


def _names(node: ast.expr) -> list[str]:
    return [_last(each) for each in ast.walk(node) if isinstance(each, ast.Name | ast.Attribute)]


def _last(node: ast.expr) -> str:
    """Return the last part of a dotted name: what it is called wherever it comes from."""
    if isinstance(node, ast.Subscript):
        return _last(node.value)
    return node.attr if isinstance(node, ast.Attribute) else node.id if isinstance(node, ast.Name) else ""


def _annotations(node: Definition) -> Iterator[ast.expr | None]:
    if isinstance(node, ast.ClassDef):
        fields = (each for each in node.body if isinstance(each, ast.AnnAssign))
        yield from (each.annotation for each in fields if not _last(each.target).startswith("_"))
        return
    given = node.args
    every = [*given.posonlyargs, *given.args, *given.kwonlyargs, given.vararg, given.kwarg]
    yield from (each.annotation for each in every if each is not None)
    yield node.returns


def _is_protocol(node: ast.ClassDef) -> bool:
    return "Protocol" in map(_last, node.bases)


def _project() -> Source:
    files = [path for floor in _FLOORS for path in sorted((_ROOT / floor).rglob("*.py"))]
    groups = (app, *(each.typer_instance for each in app.registered_groups))
    every = [command.callback for group in groups if group for command in group.registered_commands if command.callback]
    commands = {(f"{each.__module__.replace('.', '/')}.py", each.__name__) for each in every}
    return Source({path.relative_to(_ROOT).as_posix(): path.read_text("utf-8") for path in files}, commands)


@pytest.fixture(scope="module")
def project() -> Source:
    """All three floors."""
    return _project()


def test_docstrings_give_the_shapes_of_arrays(project: Source) -> None:
    """What takes, returns or holds arrays says of which shape."""
    assert len(list(project.with_arrays())) > 300, "the check no longer finds what it is there for"
    assert project.without_shape() == []


@pytest.mark.slow
def test_docstrings_name_the_exceptions(project: Source) -> None:
    """What a public function raises stands in its docstring, in its class's, or where its method was promised."""
    assert len(project.raising) > 150, "the check no longer finds what it is there for"
    assert project.without_exception() == []


def test_methods_have_docstrings(project: Source) -> None:
    """A method says what it does, unless a base class or a protocol whose method it carries out has said it."""
    assert project.without_docstring() == []


_NO_SHAPE = "gives no shape, such as (n,), of its arrays"
_ALIAS = "FloatArray = NDArray[np.float64]\n"


@pytest.mark.parametrize(
    ("text", "complaints"),
    [
        ('def f(x: FloatArray) -> float:\n    """Return x, deg/hr."""', [f"hil/a.py:2: f {_NO_SHAPE}"]),
        ('def f(x: FloatArray) -> float:\n    """Return x (n, 3), deg/hr."""', []),
        ('def f(x: float) -> np.ndarray[Any, Any]:\n    """Return x."""', [f"hil/a.py:2: f {_NO_SHAPE}"]),
        ('def f(x: float) -> dict[str, FloatArray]:\n    """Return (RA, RB)."""', [f"hil/a.py:2: f {_NO_SHAPE}"]),
        ('def f(x: Sequence[FloatArray]) -> float:\n    """Return x, (..., 2·c + 1) each."""', []),
        ('def f(x: float) -> float:\n    """Return x."""', []),
        ("def _f(x: FloatArray) -> float: ...", []),
        ("class _A:\n    def f(self, x: FloatArray) -> float: ...", []),
        ('class A:\n    """A."""\n    x: FloatArray', [f"hil/a.py:2: A {_NO_SHAPE}"]),
        ('class A:\n    """A."""\n    x: FloatArray\n    """(n,)"""', []),
        ('class A:\n    """A."""\n    def f(self, x: FloatArray) -> float: ...', [f"hil/a.py:4: A.f {_NO_SHAPE}"]),
        ('class A:\n    """Of rows (n,)."""\n    def f(self, x: FloatArray) -> float: ...', []),
        ("class A:\n    @property\n    def f(self) -> FloatArray: ...", [f"hil/a.py:4: A.f {_NO_SHAPE}"]),
        ("class A(Base):\n    def f(self, x: FloatArray) -> float: ...", []),
        ("class A(Base):\n    def g(self, x: FloatArray) -> float: ...", [f"hil/a.py:3: A.g {_NO_SHAPE}"]),
        ('class A:\n    """A `hil.Promise`."""\n    def f(self, x: FloatArray) -> float: ...', []),
        ("Pair = tuple[FloatArray, int]\ndef f(x: Pair) -> float: ...", [f"hil/a.py:3: f {_NO_SHAPE}"]),
        ("from hil.b import Rows as R\ndef f(x: R) -> float: ...", [f"hil/a.py:3: f {_NO_SHAPE}"]),
        ("from elsewhere import Rows\ndef f(x: Rows) -> float: ...", []),
    ],
)
def test_a_missing_shape_is_found(text: str, complaints: list[str]) -> None:
    """Whatever holds the array, and whatever it is called; a scalar needs none, nor does what is private."""
    known = 'class Base:\n    def f(self, x: Rows) -> float:\n        """Return x (n,)."""\n'
    known += 'class Promise(Protocol):\n    def f(self, x: Rows) -> float:\n        """Return x (n,)."""\n'
    known += "Rows = NDArray[np.uint8]"
    assert Source({"hil/a.py": _ALIAS + text, "hil/b.py": known}).without_shape() == complaints


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("class A:\n    'A.'\n    def f(self): ...", True),
        ("class A:\n    'A.'\n    def f(self):\n        'Do.'", False),
        ("class A(Base):\n    'A.'\n    def f(self): ...", False),
        ("class A(Base):\n    'A.'\n    def g(self): ...", True),
        ("class A:\n    'A `Promise`.'\n    def f(self): ...", False),
        ("class A:\n    'A.'\n    def _f(self): ...", False),
        ("class _A:\n    def f(self): ...", False),
    ],
)
def test_a_missing_docstring_is_found(text: str, found: bool) -> None:
    """What a base class or a promised protocol says of a method need not be said again."""
    known = "class Base:\n    def f(self):\n        'Do.'\nclass Promise(Protocol):\n    def f(self):\n        'Do.'"
    assert bool(Source({"hil/a.py": text, "hil/b.py": known}).without_docstring()) is found


@pytest.mark.parametrize(
    ("text", "names"),
    [
        ('def f():\n    """Do."""\n    raise ValueError("x")', ["ValueError"]),
        ('def f():\n    """Do. Raises `ValueError` where it cannot."""\n    raise ValueError("x")', []),
        ('def f():\n    """Do. Raises `BenchError`."""\n    raise errors.Broken("x") from None', []),
        ('def f():\n    """Do. Raises `Broken`."""\n    raise BenchError("x")', ["BenchError"]),
        ('def f():\n    """Do or raise `OSError`."""\n    raise FileNotFoundError', []),
        ("def f():\n    try:\n        raise Broken\n    except BenchError:\n        pass", []),
        (
            "def f():\n    try:\n        raise Broken\n    except OSError:\n        raise KeyError",
            ["Broken", "KeyError"],
        ),
        ("def f():\n    with suppress(Broken):\n        raise Broken", []),
        ("def f():\n    with g():\n        raise Broken", ["Broken"]),
        ("def f():\n    def g():\n        raise Broken\n    return g", []),
        ("def f():\n    return 1 + _g()\ndef _g():\n    raise Broken", ["Broken"]),
        ("def f():\n    return g()\ndef g():\n    'Or Broken.'\n    raise Broken", []),
        ("def f():\n    _f()\ndef _f():\n    _f()\n    raise Broken", ["Broken"]),
        (
            "class A(B):\n    def f(self):\n        self._g()\nclass B:\n    def _g(self):\n        raise Broken",
            ["Broken"],
        ),
        ("class A:\n    'A. Raises `Broken`.'\n    def __init__(self):\n        raise Broken", []),
        ("class A:\n    'A.'\n    def __post_init__(self):\n        raise Broken", ["Broken"]),
        (
            "class A:\n    @property\n    def f(self):\n        raise self.no()\n    def no(self) -> Broken: ...",
            ["Broken"],
        ),
        ("def f():\n    raise _Inside", []),
    ],
)
def test_an_exception_that_is_not_named_is_found(text: str, names: list[str]) -> None:
    """It may come from a private function of the same file; what is caught again, or private, does not count."""
    known = "class BenchError(Exception): ...\nclass Broken(BenchError): ...\nclass _Inside(Exception): ..."
    complaints = Source({"hil/a.py": text, "hil/errors.py": known}).without_exception()
    assert [complaint.split(" raises ")[1].split()[0] for complaint in complaints] == names
    assert all(re.match(r"hil/a\.py:\d+: (A\.)?\w+ raises", complaint) for complaint in complaints)


def test_a_command_names_no_exceptions() -> None:
    """What it raises becomes its exit status."""
    text = "def f():\n    'Help.'\n    raise ValueError"
    assert Source({"hil/a.py": text}).without_exception() != []
    assert Source({"hil/a.py": text}, {("hil/a.py", "f")}).without_exception() == []


def test_files_and_folders_with_a_private_name_are_left_alone() -> None:
    """They are nobody else's; the face of a package is everybody's."""
    text = "def f(x: NDArray[Any]):\n    raise ValueError"
    for path in ("hil/_a.py", "hil/_b/c.py"):
        source = Source({path: text})
        assert source.without_shape() + source.without_exception() == []
    assert len(Source({"hil/b/__init__.py": text}).without_shape()) == 1
