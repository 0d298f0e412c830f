"""YAML as people write it by hand: read strictly, and what is wrong with it in plain words.

The loader is the safe one, which in addition refuses a key that is given twice. No word of the library that found a
mistake is shown, and no key that only the program knows.
"""

import difflib
import re
from collections.abc import Hashable, Mapping, Sequence
from copy import deepcopy
from functools import cache, lru_cache
from importlib.resources import files
from typing import Any, Self

import yaml
from pydantic import BaseModel, ConfigDict, ValidationError, model_validator

from drivers.errors import InputError
from drivers.given_file import TEXT_MB, limit_bytes

_MERGE = "tag:yaml.org,2002:merge"
_BYTES_PER_VALUE = 20  # of a text as long as is read
_LARGEST_WHOLE = 2**64
_REMEMBERED_CHARACTERS = 2**16  # a text of at most so many is read once: a night reads its bench and frames ten times
_NUMBERS = ("tag:yaml.org,2002:int", "tag:yaml.org,2002:float")
_NO_VALUE = (ArithmeticError, AttributeError, LookupError, TypeError, ValueError)  # how the library says so
_LONGEST = 60  # characters of a value that are shown
_OWN_KEY = re.compile(r"([A-Za-z_]\w*(?:\.\w+)*): ")


class Section(BaseModel):
    """A mapping in a file that people write, frozen. Unknown keys are errors, with the nearest one suggested."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    @model_validator(mode="before")
    @classmethod
    def _know_every_key(cls, data: Any) -> Any:
        names = [field.alias or name for name, field in cls.model_fields.items()]
        if not isinstance(data, dict | cls):
            raise ValueError(f"must be a mapping with the keys {', '.join(names)}, not {_shown(data)}")
        for key in data if isinstance(data, dict) else ():
            if key not in names:
                raise ValueError(f"unknown key {key!r}{near(str(key), names)}")
        return data

    @model_validator(mode="after")
    def _know_what_is_possible(self) -> Self:
        self._check()
        return self

    def _check(self) -> None:
        """Raise `ValueError` where keys that are right by themselves contradict one another."""


class _StrictLoader(yaml.SafeLoader):
    """The first of two values of one key would be lost in silence, and an alias may stand for any number of values."""

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self._most = limit_bytes(TEXT_MB) // _BYTES_PER_VALUE
        self._values = 0
        self._sizes: dict[yaml.Node, int] = {}

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        before, is_alias = self._values, self.check_event(yaml.AliasEvent)
        node = super().compose_node(parent, index)
        if node is not None:
            # An alias of what it stands in, which has no size yet, has no end.
            self._values += self._sizes.get(node, self._most + 1) if is_alias else 1
            self._sizes.setdefault(node, self._values - before)
            if self._values > self._most:
                problem = f"more than {self._most} values, with each alias (*name) counted as all that it stands for"
                raise yaml.composer.ComposerError(None, None, problem, node.start_mark)
        return node

    def construct_object(self, node: yaml.Node, deep: bool = False) -> Any:
        try:
            if node.tag in _NUMBERS and len(node.value) > _LONGEST:  # 1:59:59:… is one number in YAML
                raise ValueError
            value = super().construct_object(node, deep)
            if isinstance(value, int) and abs(value) >= _LARGEST_WHOLE:
                raise ValueError
        except _NO_VALUE as error:  # such as the 99th of a month
            problem = f"{_shown(node.value)} is no value that can be (as text it needs quotes)"
            raise yaml.constructor.ConstructorError(None, None, problem, node.start_mark) from error
        return value

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        seen: set[object] = set()
        for key_node in (each for each, _ in node.value if each.tag != _MERGE):
            key = self.construct_object(key_node, deep=True)
            if isinstance(key, Hashable) and key in seen:
                raise yaml.constructor.ConstructorError(
                    None, None, f"the key {key!r} is given twice", key_node.start_mark
                )
            seen.add(key)
        return super().construct_mapping(node, deep)


def parse_value(text: str, source: str) -> Any:
    """Return what a YAML text holds; raise `InputError`, which begins with `source`, where it is none."""
    try:
        return deepcopy(_remembered(text)) if len(text) <= _REMEMBERED_CHARACTERS else _loaded(text)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        place = f", line {mark.line + 1}, column {mark.column + 1}" if mark is not None else ""
        raise InputError(f"{source}{place}: not valid YAML: {error.problem or error.context}") from error
    except yaml.YAMLError as error:
        raise InputError(f"{source}: not valid YAML: {' '.join(str(error).split())}") from error
    except RecursionError as error:
        raise InputError(f"{source}: not valid YAML: lists or mappings are nested too deeply") from error
    except _NO_VALUE as error:  # a tag (!!map) before what is none
        raise InputError(f"{source}: not valid YAML: a tag (!!…) stands before what is not of its kind") from error


def _loaded(text: str) -> Any:
    return yaml.load(text, Loader=_StrictLoader)  # noqa: S506 (a SafeLoader)


_remembered = lru_cache(maxsize=16)(_loaded)


def packaged(package: str, name: str) -> Any:
    """Return what a YAML file of a package of ours holds: a table that is data, not code."""
    loader: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
    return yaml.load((files(package) / name).read_text(encoding="utf-8"), Loader=loader)  # noqa: S506 (both are safe)


@cache
def _words() -> Any:
    return packaged("drivers", "mistakes.yaml")


def parse_yaml(text: str, source: str) -> dict[str, Any]:
    """Return the mapping that a YAML text holds; raise `InputError`, which begins with `source`, where it is none."""
    document = parse_value(text, source)
    if not isinstance(document, dict):
        found = {list: "a list", type(None): "nothing"}.get(type(document), f"{document!r}")
        raise InputError(f"{source}: must be a mapping of keys to values, not {found}")
    return document


def check_schema(document: Mapping[str, Any], schema: str, source: str) -> None:
    """Raise `InputError`, which begins with `source`, where a document is of another `schema` or does not say which."""
    if (found := document.get("schema")) != schema:
        what = "it is missing" if found is None else f"it is {found!r}"
        raise InputError(f"{source}, key schema: {what}; this program reads {schema}")


def near(word: str, allowed: Sequence[str]) -> str:
    """Return "; did you mean …?" where one of `allowed` is near, else "; allowed: …", or that there is none."""
    close = difflib.get_close_matches(word, allowed, n=1)
    every = f"allowed: {', '.join(sorted(allowed))}" if allowed else "there is none at all"
    return f"; did you mean {close[0]!r}?" if close else f"; {every}"


def first_mistake(error: ValueError, document: object) -> str:
    """Return the first thing that is wrong with `document` as one sentence that begins with its key.

    An unknown key comes before a missing one: often it is that one, misspelt. What no model says is a sentence.
    """
    if not isinstance(error, ValidationError):
        return str(error)
    problems = sorted(error.errors(include_url=False), key=lambda each: each["type"] == "missing")
    parts, sentence = _place(problems[0]), plain_words(problems[0])
    own = _OWN_KEY.match(sentence) if problems[0]["type"] == "value_error" else None
    if own is not None:
        # What is checked by itself names its place as it knows it: from its own section on, or within it.
        parts = [*(parts[:-2] if parts[-2:-1] == own[1].split(".")[:1] else parts[:-1]), *own[1].split(".")]
        sentence = sentence[own.end() :]
    place = as_written(parts, document)
    others = [as_written(_place(each), document) for each in problems]
    kinds = dict.fromkeys(_kind(each) for each, at in zip(problems, others, strict=True) if at == place)
    if len(kinds) > 1 and "" not in kinds:  # of what may be of several kinds each says that it is none
        sentence = f"must be {' or '.join(kinds)}, not {_shown(problems[0]['input'])}"
    also = dict.fromkeys(where for where in others if where not in ("", place))
    more = f" (also {', '.join(also)})" if also else ""
    return f"{place}: {sentence}{more}" if place else f"{sentence}{more}"


def _place(problem: Any) -> list[int | str]:
    """Return where a problem is; what the file does not have is only its last where just that is what is wrong."""
    kind, parts = problem["type"], list(problem["loc"])
    if kind.startswith("union_tag"):
        return [*parts, str(problem["ctx"]["discriminator"]).strip("'")]
    return parts if kind == "missing" else [*parts, ""]


def as_written(parts: Sequence[int | str], document: object) -> str:
    """Return the place in the file's words; an element of an array of fields is told as its array's."""
    place, here = [], document
    for number, part in enumerate(parts):
        key = _key_in(here, part)
        if key is not None:
            place.append(str(key))
            here = here[key]  # type: ignore[index]
        elif (array := _array_in(here, str(part))) is not None:
            place.append(array)
            here = here[array]  # type: ignore[index]
            if number == len(parts) - 1:
                place[-1] += f" (its element {part})"
        elif number == len(parts) - 1 and isinstance(part, str) and re.fullmatch(r"\w+", part):
            place.append(part)  # a key that is missing
    return ".".join(place)


def _key_in(here: object, part: int | str) -> int | str | None:
    if isinstance(here, Mapping):
        return next((key for key in here if str(key) == str(part)), None)
    is_place = isinstance(here, list | tuple) and str(part).isdigit() and int(part) < len(here)
    return int(part) if is_place else None


def _array_in(here: object, element: str) -> str | None:
    pairs = here.items() if isinstance(here, Mapping) else ()
    arrays = [str(key) for key, value in pairs if isinstance(value, Mapping) and {"names", "count"} & set(value)]
    return next((array for array in arrays if element.startswith(f"{array}_")), None)


def plain_words(problem: Any) -> str:
    """Return one of pydantic's problems (an item of `ValidationError.errors()`) in plain words, without its place."""
    kind, context = problem["type"], problem.get("ctx") or {}
    given = _shown(problem.get("input"))
    if kind == "value_error":
        return str(context["error"]).removesuffix(".")
    if kind == "missing":
        in_list = isinstance(problem["loc"][-1], int)
        return "this value of the list is missing" if in_list else "this key is missing"
    if (said := _words()["sentences"].get(kind)) is not None:
        return str(said.format(given=given, **context))
    if kind in ("too_short", "string_too_short"):
        return f"must have at least {_entries(kind, context['min_length'])}"
    if kind in ("too_long", "string_too_long"):
        return f"must have at most {_entries(kind, context['max_length'])}"
    if wanted := _kind(problem):
        return f"must be {wanted}, not {given}"
    return f"{problem['msg'][0].lower()}{problem['msg'][1:]}, not {given}"


def _kind(problem: Any) -> str:
    """Return what should stand there instead, if that is what is wrong with it."""
    return str(_words()["kinds"].get(str(problem["type"]).split("_")[0], ""))


def _entries(kind: str, count: int) -> str:
    what = "character" if kind.startswith("string") else "entry"
    return f"{count} {what}" if count == 1 else f"{count} {what.replace('entry', 'entrie')}s"


def _shown(given: object) -> str:
    if given is None:
        return "nothing"
    text = "a mapping" if isinstance(given, Mapping) else "a list" if isinstance(given, list | tuple) else repr(given)
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]}…"
