r"""The box of a description with a chamber behind it: it answers as the description says it would.

It shows whether a description hangs together and how a bench would run with it. It cannot show that a real box answers
like this: what does are published bytes and the clients of others.
"""

import math
from abc import ABC
from collections.abc import Iterator, Sequence
from contextlib import suppress
from itertools import zip_longest
from typing import Any

from drivers.chambers import ChamberLimits
from drivers.chambers.controllers.description import BoxDescription, Why
from drivers.chambers.controllers.questions import AlarmQuestion, Command, ModbusSection, Quantity, Question, Setting
from drivers.chambers.controllers.templates import filled, number_in, reply_with, taken_from
from drivers.simulators.chambers.controller import (
    ChamberFault,
    ChamberFaultKind,
    Refusal,
    SimulatedController,
    SimulatedLines,
)
from drivers.simulators.chambers.modbus import ILLEGAL_ADDRESS, ILLEGAL_VALUE, SimulatedModbus
from drivers.simulators.chambers.plant import ChamberPlant
from drivers.transports.modbus import Table

_TIME = "{value:h:m}"


class _Described(SimulatedController, ABC):
    """What a described box does, however it is spoken to."""

    _box: BoxDescription
    _beyond = ""  # its word for a setpoint beyond its limits; without one it takes any
    _shown_instead: str | None = None  # by a sensor that is broken
    dead_man_s = 0.0
    timer_ends_s: float | None = None  # once the timer is switched on

    def __post_init__(self) -> None:
        super().__post_init__()
        self.settings: dict[str, float] = {}  # beside a ramp: "setting 0.1" is the second with the first
        self._stopped = "STANDBY" if self._box.standby else "OFF"

    def _suffer(self, now_s: float) -> None:
        """Let what happens by itself happen too: its timer runs out, the air crosses an alarm limit."""
        super()._suffer(now_s)
        self._now_s = now_s
        if self.timer_ends_s is not None and now_s >= self.timer_ends_s:
            self._stop(self.timer_ends_s)
            self.timer_ends_s = None
        alarm = self._box.simulated.limit_alarm
        watches = alarm is not None and alarm not in self.alarms and self.mode in ("CONSTANT", "RUN")
        if watches and not self.limits.low_degC <= self.plant.advance(now_s) <= self.limits.high_degC:
            self.alarms = (*self.alarms, str(alarm))
            self._stop(now_s)

    def _stop(self, at_s: float) -> None:
        self.mode = "OFF" if self.mode == "OFF" else self._stopped
        self._condition(at_s)

    def _power_up(self) -> None:
        self.timer_ends_s = None

    def _answers(self, now_s: float) -> Iterator[tuple[Question | None, float | str | None]]:
        """Give every question and what is answered: a temperature or another number, or a word."""
        box, identity = self._box, self._box.identify
        own = box.simulated.identity or f"{identity.expect or box.name} SIMULATED"
        yield identity, identity.expect if box.modbus else own
        yield identity.instead, own
        yield identity.hottest, self._shown(self.limits.high_degC)
        for each in (*identity.requires, *box.believe):
            yield each, each.one_of[0] if each.one_of else None
        if box.unit is not None:
            yield box.unit, (box.unit.fahrenheit if self.fahrenheit else box.unit.celsius)[0]
        yield box.temperature, self._sensed(now_s)
        yield box.setpoint, self._shown(self.setpoint_degC)
        yield box.low_limit, self._shown(self.limits.low_degC)
        yield box.high_limit, self._shown(self.limits.high_degC)
        decided = False
        for state in box.state:
            yield state, state.word_for("next" if decided else self.mode)
            decided |= self.mode in state.modes.values()
        yield from ((each, self._alarm_word(each)) for each in box.alarms)
        yield box.alarm_list, ",".join((str(len(self.alarms)), *self.alarms))
        if told := box.messages:
            yield told.count, str(len(self.alarms))
            for number, alarm in enumerate(self.alarms, start=1):
                yield told.text.numbered(number), alarm
                yield from ((each.numbered(number), "1") for each in told.only)
        yield from zip(box.ramp_degC_per_min, self.plant.ramp_degC_per_min, strict=False)
        yield from ((each, self.settings.get(place, 0.0)) for place, each in self._with_ramps)
        if timer := box.dead_man_s:
            yield timer, filled(_TIME, value=self.dead_man_s) if _TIME in (timer.send or "") else self.dead_man_s
            yield timer.running, "0" if self.timer_ends_s is None else f"1,{timer.number}"

    def _sensed(self, now_s: float) -> float | str:
        return self._air(now_s) if self._shown_instead is None else self._shown_instead

    def _alarm_word(self, question: AlarmQuestion) -> str:
        if question.bit is not None:
            return str(int(bool(self.alarms)))
        if question.bits is not None:
            return str(sum(1 << int(alarm) for alarm in set(self.alarms)))
        if self._box.alarm_list is not None:
            return str(len(self.alarms))
        return self.alarms[0] if self.alarms else question.none[0]

    @property
    def _quantities(self) -> list[tuple[str, Quantity]]:
        box = self._box
        several = [("setpoint", box.setpoint), ("low", box.low_limit), ("high", box.high_limit)]
        several += [*zip(("ramp", "ramp down"), box.ramp_degC_per_min, strict=False), ("dead_man", box.dead_man_s)]
        return [*((name, quantity) for name, quantity in several if quantity is not None), *self._with_ramps]

    @property
    def _with_ramps(self) -> list[tuple[str, Setting]]:
        ramps = enumerate(self._box.ramp_degC_per_min)
        return [(f"setting {n}.{k}", each) for n, ramp in ramps for k, each in enumerate(ramp.also)]

    @property
    def _switches(self) -> list[tuple[Sequence[Command], str]]:
        box = self._box
        timers = ((box.dead_man_s.first, "timer off"), (box.dead_man_s.then, "timer on")) if box.dead_man_s else ()
        modes = ((box.start, "start"), (box.stop, "OFF"), (box.standby, "STANDBY"), (box.end_program, "end"))
        return [*modes, *timers]

    def _adopt(self, name: str, value: float) -> None:
        match name:
            case "setpoint":
                self.setpoint_degC = self._rounded(value)
            case "low":
                self.limits = ChamberLimits(self._rounded(value), self.limits.high_degC)
            case "high":
                self.limits = ChamberLimits(self.limits.low_degC, self._rounded(value))
            case "ramp":
                self.plant.ramp_degC_per_min = (value, value)
            case "ramp down":
                self.plant.ramp_degC_per_min = (self.plant.ramp_degC_per_min[0], value)
            case "dead_man":
                self.dead_man_s = value
            case _:
                self.settings[name] = value

    def _adopt_guarded(self, name: str, value: float) -> None:
        before = self.setpoint_degC, self.limits
        self._adopt(name, value)
        guarded = self._beyond and self._box.low_limit is not None and not self._box.simulated.takes_any_setpoint
        if guarded and not self.limits.low_degC <= self.setpoint_degC <= self.limits.high_degC:
            self.setpoint_degC, self.limits = before
            raise Refusal(self._beyond)

    def _switch(self, command: Command, what: str) -> None:
        match what:
            case _ if command.where is not None:  # what goes before the start: its power
                self.mode = "STANDBY" if self.mode == command.where else self.mode
            case "start":
                self.mode = "RUN" if self.mode == "RUN" else "CONSTANT"
            case "end":
                self._end_program()
            case "timer on":
                self.timer_ends_s = self._now_s + self.dead_man_s
            case "timer off":
                self.timer_ends_s = None
            case _:
                self.mode = what

    def _end_program(self) -> None:
        """End a program, if one runs: it then stands by where it can, else it holds its setpoint."""
        if self.mode == "RUN":
            self.mode = "STANDBY" if self._box.standby else "CONSTANT"

    def _rounded(self, value: float) -> float:
        return round(self._taken(value), 4)  # a 32-bit float is not quite what was meant


class SimulatedSetpointBox(_Described, SimulatedLines):
    """A `SimulatedDevice` made from a description of text. What it does not understand it refuses, if it has words.

    Whatever does not matter in a confirmation is what it was told. What comes before the pause that the box asks for
    is over is answered all the same; where it is `strict`, it is dropped without a word.
    """

    strict = False

    def __init__(self, plant: ChamberPlant, description: BoxDescription, **settings: Any) -> None:
        self._box, own = description, description.simulated
        self._usual_alarm, self._beyond = own.alarm, own.refuses.get("value", "")
        if own.limits is not None:
            settings = {"limits": ChamberLimits(*own.limits), **settings}
        super().__init__(plant, description.framings, **settings)

    def _take(self, request: bytes, now_s: float) -> None:
        if super()._name(request).startswith(self._box.addressed):
            super()._take(request, now_s)

    def _name(self, request: bytes) -> str:
        text = super()._name(request).removeprefix(self._box.addressed)
        return text.upper() if self._box.simulated.any_case else text

    def _pause_after(self, request: bytes) -> float:
        asks, box = self._name(request) in self._questions, self._box
        return (box.pause_after_question_s if asks else box.pause_after_setting_s) if self.strict else 0.0

    def _turn(self, fault: ChamberFault, *, on: bool) -> None:
        super()._turn(fault, on=on)
        if fault.kind is ChamberFaultKind.SENSOR_BROKEN:
            self._shown_instead = fault.text if on else None

    def _respond(self, request: str, now_s: float) -> str | None:
        if (answer := self._answer_to(request, now_s)) is not None:
            return answer
        self._refuse_if_locked()
        for commands, mode in self._switches:
            for command in commands:
                if (found := taken_from(command.send or "", request)) is not None:
                    if "setpoint" in found:
                        self._adopt("setpoint", float(found["setpoint"]))
                    self._switch(command, mode)
                    return filled(command.confirm[0], any=request) if command.confirm else None
        for name, quantity in self._quantities:
            if (found := taken_from(quantity.send or "", request)) is not None:
                self._adopt_guarded(name, value := number_in(found["value"]))
                return filled(quantity.confirm[0], any=request, value=value) if quantity.confirm else None
        raise Refusal(self._because("parameter") if _head(request) in self._heads else self._refusal())

    @property
    def _questions(self) -> set[str]:
        asked = {each.ask for each, _ in self._answers(self._now_s) if each and each.ask}
        return asked | self._box.simulated.answers.keys()

    @property
    def _heads(self) -> set[str]:
        """The first words of all that it understands."""
        told = [each for commands, _ in self._switches for each in commands] + [each for _, each in self._quantities]
        return {_head(text) for text in (*self._questions, *(each.send or "" for each in told))}

    def _because(self, why: Why) -> str:
        return self._box.simulated.refuses.get(why, "")

    def _refusal(self) -> str:
        return self._because("locked") if self.panel_locked else ""

    def _end_program(self) -> None:
        if self.mode != "RUN" and (word := self._because("program")):
            raise Refusal(word)
        super()._end_program()

    def _answer_to(self, request: str, now_s: float) -> str | None:
        """Return what the description itself answers, and behind it, field by field, what this text asks."""
        answered = [
            (each, value) for each, value in self._answers(now_s) if each and each.ask == request and value is not None
        ]
        bits = sum(int(value) << each.bit for each, value in answered if each.bit is not None)
        lines = [
            reply_with(each.reply, self._written(bits if each.bit is not None else value)) for each, value in answered
        ]
        own = self._box.simulated.answers.get(request)
        if not lines and own is None:
            return None
        each_field = zip_longest(*(line.split(",") for line in lines), fillvalue="")
        fields = ["".join(max(column) for column in zip_longest(*each, fillvalue=" ")) for each in each_field]
        said = [] if own is None else self._own(own, now_s).split(",")
        return ",".join(one or other for one, other in zip_longest(said, fields, fillvalue=""))

    def _own(self, answer: str, now_s: float) -> str:
        mode = self._box.state[0].word_for(self.mode) if self._box.state else ""
        air = self._written(self._sensed(now_s))
        return filled(answer, value=air, setpoint=self._shown(self.setpoint_degC), mode=mode)

    def _written(self, value: float | str) -> str:
        return f"{value:.{self._box.simulated.decimals}f}" if isinstance(value, float) else str(value)

    def _refused(self, request: bytes, refusal: Refusal) -> bytes:
        said = str(refusal) or next(iter(self._box.refusals), "5")
        return self._line(next((reply_with(each, said) for each in self._box.refused), None))


class SimulatedRegisterBox(_Described, SimulatedModbus):
    """A `SimulatedDevice` made from a description of registers.

    A register that the description does not have is exception 2, a value that it does not take exception 3: half of a
    32-bit number, a setpoint beyond its limits, limits that exclude the setpoint (inferred; where it does not take
    any). Alarms have the numbers of their registers, and of their bits: `102`, `57.0`.
    """

    _beyond = ILLEGAL_VALUE

    def __init__(self, plant: ChamberPlant, description: BoxDescription, **settings: Any) -> None:
        self._box, self._map, own = description, description.modbus or ModbusSection(), description.simulated
        self.registers = {each: value for (a, b), value in own.registers.items() for each in range(a, b + 1)}
        self._usual_alarm = next((_alarm_id(each) for each in description.alarms), "")
        self._silent_refusals = own.silent_refusals
        self._coils = any(each.table in ("coil", "discrete") for _, each in description.named)
        settings = {"pause_s": own.pause_s, **settings}
        super().__init__(plant, address=self._map.address, framing=self._map.framing, **settings)

    def _register(self, address: int, now_s: float, table: Table) -> int:
        address, table = self._box.simulated.same.get(address, address), self._own(table)
        word, known = self.registers.get(address, 0), address in self.registers
        for question, value in self._answers(now_s):
            if question is None or question.address is None or question.table != table or value in (None, ""):
                continue
            if 0 <= (place := address - question.address) < self._map.width(question):
                if question.bit is None:
                    return self._held(question, float(value))[place]
                word, known = word & ~(1 << question.bit) | int(value) << question.bit, True
        if not known:
            raise Refusal(ILLEGAL_ADDRESS)
        return word

    def _set_registers(self, address: int, values: list[int], table: Table) -> None:
        while values:
            taken = self._set_one(address, values, table)
            address, values = address + taken, values[taken:]

    def _set_one(self, address: int, values: list[int], table: Table) -> int:
        for name, quantity in self._quantities:
            for begins in quantity.written_to if quantity.table == table else ():
                size = self._map.width(quantity)
                if begins < address < begins + size or (address == begins and len(values) < size):
                    raise Refusal(ILLEGAL_VALUE)
                if address == begins:
                    self._adopt_guarded(name, self._map.number(quantity, values[:size], self._decimals))
                    return size
        there = [
            (command.value == (values[0] if command.bit is None else values[0] >> command.bit & 1), command, mode)
            for commands, mode in self._switches
            for command in commands
            if (command.address, command.table) == (address, table)
        ]
        if not there and address not in self.registers:
            raise Refusal(ILLEGAL_ADDRESS)
        if there and not any(meant for meant, *_ in there):
            raise Refusal(ILLEGAL_VALUE)
        for command, mode in [(command, mode) for meant, command, mode in there if meant][:1]:
            self._switch(command, mode)
        self.registers[address] = values[0]
        return 1

    def _alarm_word(self, question: AlarmQuestion) -> str:
        if question.bits is None:
            return "1" if _alarm_id(question) in self.alarms else question.none[0]
        return str(sum(1 << bit for bit in range(16) if f"{question.address}.{bit}" in self.alarms))

    def _own(self, table: Table) -> Table:
        has_inputs = any(each.table == "input" for _, each in self._box.named)
        return "holding" if table == "input" and not has_inputs else table

    @property
    def _decimals(self) -> int | None:
        register = self._map.decimals_register
        return None if register is None else self.registers[register]

    def _held(self, question: Question, value: float) -> tuple[int, ...]:
        """Return the registers that hold a value, or the most or least that they can."""
        for reachable in (value, 3276.7, -3276.8, 0.0):
            with suppress(ValueError):
                return self._map.registers(question, math.copysign(reachable, value), self._decimals)
        raise Refusal(ILLEGAL_VALUE)


def _head(text: str) -> str:
    return text.partition(",")[0]


def _alarm_id(question: AlarmQuestion) -> str:
    return str(question.address) if question.bits is None else f"{question.address}.{min(question.bits)}"


def simulated_box(plant: ChamberPlant, description: BoxDescription, **settings: Any) -> _Described:
    """Return the simulated box of any description; one that cannot be switched over the line is on."""
    if not description.state:
        settings = {"mode": "CONSTANT", **settings}
    kind = SimulatedSetpointBox if description.modbus is None else SimulatedRegisterBox
    return kind(plant, description, **settings)
