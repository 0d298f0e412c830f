"""What a step of each kind does to the bench, apart from when and why: that is the sequencer's.

Every action leaves a `StepResult` or raises: `DeviceError` for a device that did not do what it was asked (which may
be tried again), `InterlockTripped` and `StopRequested` from the polls inside.
"""

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass

from drivers.chambers import SafeState
from drivers.errors import DeviceError, WrongDevice
from drivers.imu import ImuIdentity
from procedures.collect import Times, WrongPose, take_collect
from procedures.devices import BenchDevices
from procedures.interlocks import InterlockTripped
from procedures.journal_protocol import Outcome, StepResult
from procedures.plan import Step, StepKind
from procedures.restabilisation import restabilise
from procedures.safe_air import Left, watch_air
from procedures.settings import CollectSettings, InterlockSettings, Restabilisation
from procedures.verdict import Judgement, Verdict, combine
from procedures.watch import Watch

_READ_S = 100.0  # longer than one look at a chamber that does not answer takes


@dataclass
class BenchState:
    """What this run knows about the bench, in campaign seconds. What it does not know is None."""

    power_on_s: float | None = None
    setpoint_s: float | None = None
    setpoint_degC: float | None = None
    index_s: float | None = None
    soak: Judgement | None = None  # of the restabilisation in effect


class Actions:
    """The actions on one bench. `recorded` are the results of steps that were completed before, by key."""

    def __init__(
        self,
        devices: BenchDevices,
        watch: Watch,
        interlocks: InterlockSettings,
        recorded: Mapping[str, StepResult],
        power_on_s: float | None,
    ) -> None:
        self._devices = devices
        self._watch = watch
        self._interlocks = interlocks
        self._recorded = recorded
        self._state = BenchState(power_on_s=power_on_s)
        self._ramp_degC_per_min = 3.0
        self.chamber_refused = False  # what answers is not the bench's chamber: send it nothing at all
        self._actions: Mapping[StepKind, Callable[[Step], StepResult]] = {
            StepKind.IDENTIFY: self._identify,
            StepKind.SETPOINT: self._setpoint,
            StepKind.RESTABILISE: self._restabilise,
            StepKind.INDEX: self._index,
            StepKind.COLLECT: self._collect,
            StepKind.SAFE_STATE: self._safe_state,
        }

    def perform(self, step: Step) -> StepResult:
        """Do what the step says."""
        return self._actions[step.kind](step)

    def _identify(self, step: Step) -> StepResult:
        """Ask the devices who they are; the unit must be the one with which the sweep began."""
        # The chamber first: if the unit is the wrong one, the chamber can still be brought to its safe state.
        try:
            chamber = self._devices.chamber.identify()
        except WrongDevice:
            self.chamber_refused = True
            raise
        recorded = self._recorded.get(step.key)
        if self._watch.unit is None and recorded and "imu" in recorded.data:
            self._watch.unit = ImuIdentity(**recorded.data["imu"])
        unit = self._watch.same_unit()
        self._devices.refuse_undeclared_simulation(*vars(unit).values(), chamber.model)
        self._devices.chamber.prepare()
        self._watch.forget_stream()
        self._watch.poll()
        return StepResult(Outcome.DONE, "devices identified", {"imu": dict(vars(unit)), "chamber": dict(vars(chamber))})

    def _setpoint(self, step: Step) -> StepResult:
        """Command the chamber and wait until its air arrives in the band; a ramp that takes too long is a fault."""
        target_degC = _needed(step.temperature_degC)
        from_degC = self._command(step, target_degC)
        self._ramp_degC_per_min = step.parameters["ramp_degC_per_min"]
        expected_s = 60.0 * abs(target_degC - from_degC) / self._ramp_degC_per_min
        allowed_s = self._interlocks.ramp_factor * expected_s + self._interlocks.ramp_extra_s
        began_s = self._watch.now_s
        self._watch.note = f"ramping to {target_degC:.1f} °C"
        for look, _ in self._watch.wait(began_s + allowed_s):
            if look.chamber is None or not look.chamber_fresh:
                continue
            if abs(look.chamber.temperature_degC - target_degC) <= step.parameters["band_degC"]:
                self._watch.arrived = True
                data = {
                    "setpoint_degC": target_degC,
                    "commanded_s": self._state.setpoint_s,
                    "from_degC": from_degC,
                    "ramp_s": self._watch.now_s - began_s,
                }
                return StepResult(Outcome.DONE, f"arrived at {look.chamber.temperature_degC:.1f} °C", data)
        raise InterlockTripped(
            "ramp-too-long", f"the chamber did not reach {target_degC:.1f} °C within {allowed_s / 60.0:.0f} min"
        )

    def _command(self, step: Step, target_degC: float) -> float:
        """Give the chamber its setpoint and return the temperature it was at.

        Where it is already there and was told to be, the time since the setpoint counts from the first command.
        """
        now = self._devices.chamber.read()
        self._watch.commanded(None)
        self._devices.chamber.set_temperature(target_degC)
        self._watch.commanded(target_degC)
        before = self._recorded.get(step.key)
        held = max(abs(now.setpoint_degC - target_degC), abs(now.temperature_degC - target_degC))
        if before is not None and held <= step.parameters["band_degC"]:
            self._state.setpoint_s = before.data.get("commanded_s")
        elif self._state.setpoint_degC != target_degC:
            self._state.setpoint_s = self._watch.campaign_s()
        self._state.setpoint_degC = target_degC
        return now.temperature_degC

    def _restabilise(self, step: Step) -> StepResult:
        """Wait for the evidence; at the ceiling go on to an INCONCLUSIVE self-calibration, or give it up."""
        settings = Restabilisation.from_parameters(step.parameters)
        sensors = self._devices.imu.sensors
        thermometers = [number for number, channels in sensors.items() if channels.temperature is not None]
        result = restabilise(self._watch, settings, thermometers)
        self._state.soak = Judgement(Verdict(result.data["verdict"]), result.reason)
        outcome = Outcome.DONE if result.met or settings.collect_at_ceiling else Outcome.TIMEOUT
        return StepResult(outcome, result.reason, {"setpoint_degC": step.temperature_degC, **result.data})

    def _index(self, step: Step) -> StepResult:
        """Bring the unit to its position and see it confirmed."""
        position = step.position or ""
        began_s = self._watch.now_s
        self._watch.note = f"moving to position {position}"
        self._watch.poll()
        self._watch.alive(step.parameters["index_timeout_s"])
        self._devices.positioner.move_to(position, step.parameters["index_timeout_s"])
        reached = self._devices.positioner.position()
        if reached != position:
            raise DeviceError(f"the unit was sent to position {position} and confirms {reached or 'nothing'}")
        self._watch.forget_stream()
        self._state.index_s = self._watch.campaign_s()
        moved_s = self._watch.now_s - began_s
        return StepResult(Outcome.DONE, f"at position {position}", {"position": position, "moved_s": moved_s})

    def _collect(self, step: Step) -> StepResult:
        """Take a collect. FAILED, with its samples, where it gives no usable mean; before any where the pose is wrong.

        Its verdict is never better than that of the soak before it: after a resume that soak is not the one in the
        journal. `samples_verdict` is the collect's own.
        """
        settings = CollectSettings.from_parameters(step.parameters)
        state = self._state
        times = Times(state.power_on_s, state.setpoint_s, state.index_s)
        try:
            taken = take_collect(self._devices, self._watch, settings, step.position or "", times)
        except WrongPose as lies:
            return StepResult(Outcome.FAILED, str(lies), {"verdict": Verdict.FAIL.value, "wrong_pose": str(lies)})
        outcome = Outcome.DONE if taken.usable else Outcome.FAILED
        own = taken.judgement
        whole = combine([own, state.soak] if state.soak else [own], passed=own.reason)
        verdicts = {"verdict": whole.verdict.value, "samples_verdict": own.verdict.value, "reason": whole.reason}
        return StepResult(outcome, whole.reason, {**taken.data, **verdicts}, taken.samples)

    def _safe_state(self, _step: Step) -> StepResult:
        """Leave the chamber as it may be left."""
        self._watch.commanded(None)
        self._state.setpoint_degC = None
        left = self.watch_air(self._devices.chamber.safe_state())
        if not left.safe:
            raise InterlockTripped("chamber-not-safe", left.reason)
        return StepResult(Outcome.DONE, str(left), {"chamber": left.word.value})

    def watch_air(self, safe: SafeState) -> Left:
        """Look at the air until it shows that the safe state acts; nothing but the chamber can end that."""
        watch, told = self._watch, list[str]()

        def waiting(seen: str) -> None:
            watch.alive(watch.polling.interval_s + _READ_S)
            with suppress(Exception):  # a journal that fails must not end the look at the chamber
                (watch.tell if told else watch.event)("safe-state-commanded", seen)
            told.append(seen)

        chamber, clock = self._devices.chamber, self._devices.clock
        return watch_air(chamber, clock, safe, watch.polling, waiting, self._ramp_degC_per_min)


def _needed(temperature_degC: float | None) -> float:
    if temperature_degC is None:
        raise ValueError("a setpoint step without a temperature is no step")
    return temperature_degC
