"""A pause: the bench is held as it is until somebody says continue; what that did to the unit decides what is redone.

The setpoint stays commanded, every interlock but the loss of the stream is judged (a pause is for cables), and a stop
or an abort is heard. Afterwards the devices are identified and the unit is positioned again, because hands were on the
bench. The soak counts on where logged readings prove that the air stayed in its band and the unit kept its power.
"""

from dataclasses import dataclass

from procedures.interlocks import InterlockTripped, of_unit
from procedures.settings import Restabilisation
from procedures.watch import Looks, Watch


@dataclass(eq=False)
class HeldBand:
    """Whether the unit's equilibrium outlasts a pause. Neither may fail for longer than the excursion time."""

    settings: Restabilisation
    setpoint_degC: float | None
    began_s: float
    lost = ""  # why it does not, in words

    def __post_init__(self) -> None:
        self._air_s = self.began_s
        self._unit_s: dict[str, float] = {}

    def look(self, looks: Looks) -> None:
        """Take one look in."""
        look = next(iter(looks.values()))
        fresh = look.chamber if look.chamber_fresh else None
        allowed_s, band = self.settings.excursion_s, self.settings.band_degC
        if fresh and self.setpoint_degC is not None and abs(fresh.temperature_degC - self.setpoint_degC) <= band:
            self._air_s = look.time_s
        self._unit_s.update((name, each.time_s) for name, each in looks.items() if each.samples)
        if look.time_s - self._air_s > allowed_s:
            self.lost = f"the air was not shown to stay within {band:g} °C of the setpoint"
        elif silent := [n for n in looks if look.time_s - self._unit_s.get(n, self.began_s) > allowed_s]:
            self.lost = f"{of_unit(silent[0])}the unit was silent and may have been without power"


def rest(watch: Watch, settings: Restabilisation, longest_s: float, *, soaked: bool) -> str:
    """Hold the bench until the pause ends; return why the soak must start over, or nothing.

    `soaked` says that the soak of the present self-calibration was finished before. Raises what a poll raises, and
    `InterlockTripped` where nobody came back within `longest_s`.
    """
    asked = watch.desk.pause
    if asked is None:
        return ""
    began_s = watch.now_s
    at = "" if watch.commanded_degC is None else f" at {watch.commanded_degC:.1f} °C"
    held = HeldBand(settings, watch.commanded_degC, began_s)
    watch.event("pause", f"paused by {asked}; the chamber is held{at}", who=asked.who, why=asked.why)
    watch.resting = True
    try:
        while watch.desk.pause is not None:
            watch.note = f"paused by {asked}"
            if watch.now_s - began_s >= longest_s:
                raise InterlockTripped("paused-too-long", f"paused by {asked}, and nobody came back")
            held.look(watch.look_again())
    finally:
        watch.resting, watch.note = False, ""
    lasted_s = watch.now_s - began_s
    lost = held.lost if soaked else "it was not finished"
    soak = f"the soak starts over: {lost}" if lost else "the soak still counts: the air stayed in its band"
    by = watch.desk.continued_by
    said = f"{by} goes on after {lasted_s / 60.0:.0f} min; {soak}"
    watch.event("continue", said, who=by, paused_s=lasted_s, soak_kept=not lost, reason=lost)
    return lost
