"""What measures the program finds the names that it takes from it: what is seldom started breaks unseen."""

import importlib
from pathlib import Path

import pytest

import benchmarks

FOLDER = Path(benchmarks.__path__[0])


@pytest.mark.parametrize("path", sorted(FOLDER.rglob("*.py")), ids=lambda path: str(path.relative_to(FOLDER)))
def test_every_measurement_finds_what_it_imports(path: Path) -> None:
    """Each module of the benchmarks is imported as it would be started."""
    importlib.import_module(".".join(path.relative_to(FOLDER.parent).with_suffix("").parts))
