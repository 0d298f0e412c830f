"""Finding configuration files by name, reading them strictly, and saying in one sentence what is wrong with one.

find_config("benches", "simulated")     # the file that ships with hil
find_config("benches", "./my-bench.yaml")  # a path given in full wins
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import ClassVar, Self, TypeVar

from pydantic import BaseModel, PrivateAttr, ValidationError

from drivers.given_file import read_text as read_text
from drivers.outside import brought, loaded
from drivers.strict_yaml import Section as Section
from drivers.strict_yaml import first_mistake
from drivers.strict_yaml import near as near
from drivers.strict_yaml import parse_yaml as parse_yaml
from hil.errors import InputError, worded

SINGULAR = {
    "benches": "bench",
    "chambers": "chamber description",
    "imus": "IMU description",
    "limits": "set of limits",
    "models": "model",
    "sweeps": "sweep",
    "tables": "table",
}
"""The kinds of configuration: the folder's name, and the word for one of them."""

NAME, REMARK = 60, 500
"""Characters of a person's name or a label, and of what somebody says for the record: both fit on a screen."""


def one_line(what: str, text: object, longest: int = REMARK) -> str:
    """Return what a person gave as `what`, without blanks around it; raise `InputError` where it is no single line."""
    if not isinstance(text, str) or len(text) > longest or not text.isprintable():
        raise InputError(f"{what}: one line of at most {longest} characters")
    return text.strip()


class WholeFile(Section):
    """A configuration file as a whole: `text` is the YAML that it was read from, what a record keeps."""

    folder: ClassVar[str]  # of those that ship: a key of `SINGULAR`
    _text: str = PrivateAttr(default="")
    _source: str = PrivateAttr(default="")

    @property
    def text(self) -> str:
        """The YAML text."""
        return self._text

    @property
    def source(self) -> str:
        """The file."""
        return self._source

    @classmethod
    def parse(cls, text: str, source: str) -> Self:
        """Read from YAML text; `source` names it in messages. Raises `InputError` in one sentence."""
        document = parse_yaml(text, source)
        with worded(InputError, f"{source}: "):
            found = validated_inside(cls, document)
        found._text, found._source = text, source
        return found

    @classmethod
    def load(cls, name: str | Path, beside: Path | None = None) -> Self:
        """Read a file, by path or by the name of one that ships with hil; raise `InputError` in one sentence."""
        path = find_config(cls.folder, name, beside)
        return cls.parse(read_text(path), str(path))


def config_folders(kind: str) -> list[Path]:
    """Return the folders of shipped configuration of a kind: the installed package's, and the checkout's."""
    package = Path(__file__).resolve().parents[1]
    return [folder for folder in (package / "configs" / kind, package.parent / "configs" / kind) if folder.is_dir()]


def find_config(kind: str, name: str | Path, beside: Path | None = None, built_in: Sequence[str] = ()) -> Path:
    """Return the file for `name`, with or without `.yaml` (a table's `.csv`), from anywhere.

    An existing path wins, then a file of that name in the folder `beside` (where the file stands that names it), then
    what ships with hil, then what an installed distribution brings. `kind` is a key of `SINGULAR`. Raises `InputError`
    naming the nearest, of those that are `built_in`, too.
    """
    what = SINGULAR.get(kind, kind)
    if not str(name).strip():
        raise InputError(f"{str(name)!r}: the name of the {what} is empty")
    path = Path(name).expanduser()
    if _is(Path.exists, path) and not path.is_dir():  # whether it is a file is for the door to say
        return path
    folders, ending = config_folders(kind), ".csv" if kind == "tables" else ".yaml"
    for folder in () if path.is_absolute() else (*([beside] if beside is not None else []), *folders):
        for candidate in (folder / path, folder / f"{path}{ending}"):
            if _is(Path.is_file, candidate):
                return candidate
    if kind == "imus" and str(name) in brought("hil.frames"):
        return Path(loaded(brought("hil.frames")[str(name)]))
    if _is(Path.is_dir, path):
        raise InputError(f"{name}: this is a folder, not the file of {'an' if what[0] in 'AEIOU' else 'a'} {what}")
    shipped = sorted({file.stem for folder in folders for file in folder.glob(f"*{ending}")})
    if path.is_absolute() or "/" in str(name):
        raise InputError(f"{name}: there is no such file or folder")
    raise InputError(
        f"{name}: there is no {what} of this name, nor such a file or folder{near(path.stem, [*built_in, *shipped])}"
    )


def _is(what: Callable[[Path], bool], path: Path) -> bool:
    """Ask the system about a path; what it takes for no path at all (a name that is too long) is nothing."""
    try:
        return what(path)
    except OSError:
        return False


ModelT = TypeVar("ModelT", bound=BaseModel)


def validated_inside(model: type[ModelT], given: object, context: object = None) -> ModelT:
    """Return `given` as a `model`, for another validator too; raise `ValueError` with the place of what is wrong."""
    try:
        return model.model_validate(given, context=context)
    except ValidationError as error:
        raise ValueError(first_mistake(error, given)) from error
