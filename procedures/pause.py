"""A pause: the bench is held as it is until somebody says continue; what that did to the unit decides what is redone.

The setpoint stays commanded, every interlock but the loss of the stream is judged (a pause is for cables), and a stop
or an abort is heard. Afterwards the devices are identified and the unit is positioned again, because hands were on the
bench. The soak counts on where logged readings prove that the air stayed in its band and the unit kept its power.
"""

from procedures.interlocks import InterlockTripped, of_unit
from procedures.settings import Restabilisation
from procedures.watch import Watch


def rest(watch: Watch, settings: Restabilisation, longest_s: float, *, soaked: bool) -> str:
    """Hold the bench until the pause ends; return why the soak must start over, or nothing.

    `soaked` says that the soak of the present self-calibration was finished before. Raises what a poll raises, and
    `InterlockTripped` where nobody came back within `longest_s`.
    """
    asked, setpoint_degC, band = watch.desk.pause, watch.commanded_degC, settings.band_degC
    if asked is None:
        return ""
    at = "" if setpoint_degC is None else f" at {setpoint_degC:.1f} °C"
    air_s, lost = (began_s := watch.now_s), "" if soaked else "it was not finished"
    unit_s: dict[str, float] = {}
    watch.event("pause", f"paused by {asked}; the chamber is held{at}", who=asked.who, why=asked.why)
    watch.resting = True
    try:
        while watch.desk.pause is not None:
            watch.note = f"paused by {asked}"
            if watch.now_s - began_s >= longest_s:
                raise InterlockTripped("paused-too-long", f"paused by {asked}, and nobody came back")
            looks = watch.look_again()
            look = next(iter(looks.values()))
            fresh = look.chamber if look.chamber_fresh else None
            if fresh and setpoint_degC is not None and abs(fresh.temperature_degC - setpoint_degC) <= band:
                air_s = look.time_s
            unit_s.update((name, each.time_s) for name, each in looks.items() if each.samples)
            silent = [n for n in looks if look.time_s - unit_s.get(n, began_s) > settings.excursion_s]
            if soaked and look.time_s - air_s > settings.excursion_s:  # neither may fail for longer
                lost = f"the air was not shown to stay within {band:g} °C of the setpoint"
            elif soaked and silent:
                lost = f"{of_unit(silent[0])}the unit was silent and may have been without power"
    finally:
        watch.resting, watch.note = False, ""
    lasted_s = watch.now_s - began_s
    soak = f"the soak starts over: {lost}" if lost else "the soak still counts: the air stayed in its band"
    by = watch.desk.continued_by
    said = f"{by} goes on after {lasted_s / 60.0:.0f} min; {soak}"
    watch.event("continue", said, who=by, paused_s=lasted_s, soak_kept=not lost, reason=lost)
    return lost
