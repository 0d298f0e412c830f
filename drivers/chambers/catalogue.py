"""Every chamber driver by the name that a bench file gives it, and the line settings that its maker ships it with.

The simulator of each is under the same name in `drivers.simulators.chambers`.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from drivers.chambers.controllers.described import SetpointBox
from drivers.chambers.controllers.description import BoxDescription, load_box
from drivers.chambers.controllers.description import SerialLine as SerialLine
from drivers.chambers.controllers.voetsch_ascii import AsciiLayout, VoetschAscii
from drivers.chambers.supervised import SupervisedChamber, Supervision
from drivers.clock import Clock
from drivers.outside import Catalogue
from drivers.transports import Transport
from drivers.transports.framing import Terminator
from drivers.transports.modbus import Framing

WarningLimits = Literal["SP_03/04", "SP_01/02", "none"]


@dataclass(frozen=True)
class Spoken:
    """What a bench file says about how its chamber is spoken to; what is None is as its maker ships it.

    `framing` is that of Modbus, `description` the file that describes a box; `layout` says what an ASCII-2 chamber's
    values are, `warning_limits` where a Julabo has its own.
    """

    address: int | None = None
    terminator: Terminator | None = None
    framing: Framing | None = None
    description: Path | None = None
    layout: AsciiLayout | None = None
    warning_limits: WarningLimits | None = None

    def said(self, *names: str) -> dict[str, Any]:
        """Return what is not None of these."""
        return {name: value for name in names if (value := getattr(self, name)) is not None}

    def box(self, usual: Path | None) -> BoxDescription:
        """Return the description in the bench file's own file, or the `usual`, as it is for this chamber.

        Raises `ValueError` without either (only a simulator may lack both), and `InputError` where it is not right.
        """
        if (path := self.description or usual) is None:
            raise ValueError("it has no description, and no simulator of its own")
        variant, framing = self.warning_limits, self.framing
        return load_box(path, variant=variant, terminator=self.terminator, address=self.address, framing=framing)


@dataclass(frozen=True)
class ChamberOptions(Spoken, Supervision):
    """What a bench file says about its chamber."""


Build = Callable[[Transport, Clock, ChamberOptions], SupervisedChamber]


@dataclass(frozen=True)
class ChamberDriver:
    """One driver: how a person calls its controllers, their line, and how it is put together.

    `dead_man` says that its controllers can have a timer of their own which stops them when they are left alone.
    `description` is the file that says what its controllers speak, where that is no code; `simulator` is how a driver
    from outside brings its own (`drivers.simulators.chambers.catalogue` has ours).
    """

    title: str
    line: SerialLine
    build: Build
    dead_man: bool = False
    description: Path | None = None
    simulator: Callable[..., Any] | None = None


supervised = SupervisedChamber
"""What puts over a controller what all drivers do, as distributions from outside call it."""


def _ascii2(transport: Transport, clock: Clock, options: ChamberOptions) -> SupervisedChamber:
    spoken = options.said("limits", "address", "layout", "terminator")
    return supervised(VoetschAscii(transport, clock, **spoken), clock, options)


def _speaks(usual: Path | None) -> Build:
    return lambda port, clock, asks: supervised(SetpointBox(port, clock, asks.box(usual)), clock, asks)


def _described(path: Path) -> ChamberDriver:
    box = load_box(path)
    return ChamberDriver(box.title or box.name, box.line, _speaks(path), box.dead_man_s is not None, path)


SHIPPED: Mapping[str, ChamberDriver] = {
    **{path.stem: _described(path) for path in sorted((Path(__file__).parent / "boxes").glob("*.yaml"))},
    "voetsch-ascii2": ChamberDriver("Vötsch and Weiss, ASCII-2", SerialLine(9600), _ascii2),
    "box": ChamberDriver("Any chamber that a file describes", SerialLine(9600), _speaks(None), dead_man=True),
}

# What a distribution brings is a driver, or the file that describes one.
CHAMBER_DRIVERS: Mapping[str, ChamberDriver] = Catalogue(
    "hil.chambers", SHIPPED, lambda entry: entry if isinstance(entry, ChamberDriver) else _described(Path(entry))
)
