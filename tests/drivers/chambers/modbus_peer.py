"""pymodbus' own server, in a thread, as the peer of our Modbus drivers: a bank of registers without any chamber."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

from pymodbus import FramerType
from pymodbus.server import ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice


def _registers(registers: Mapping[int, int]) -> list[SimData]:
    return [
        SimData(address, values=value & 0xFFFF, datatype=DataType.REGISTERS)
        for address, value in sorted(registers.items())
    ]


@contextmanager
def modbus_server(
    registers: Mapping[int, int],
    framer: FramerType,
    *,
    inputs: Mapping[int, int] | None = None,
    coils: Sequence[int] = (),
    discretes: Sequence[int] = (),
) -> Iterator[str]:
    """Serve `registers` of unit 1 on a free port of this machine; gives the URL that a driver opens.

    With `inputs` the holding registers, input registers, coils and discrete inputs are four tables; else they are one.
    """
    data: Any = _registers(registers)
    if inputs is not None:
        bits = [
            [SimData(place, values=bool(bit), datatype=DataType.BITS) for place, bit in enumerate(each)]
            for each in (coils, discretes)
        ]
        data = (*bits, data, _registers(inputs))
    started: threading.Event = threading.Event()
    shared: dict[str, Any] = {}

    async def serve() -> None:
        server = ModbusTcpServer(SimDevice(1, simdata=data), framer=framer, address=("127.0.0.1", 0))
        await server.serve_forever(background=True)
        shared.update(
            loop=asyncio.get_running_loop(),
            stop=asyncio.Event(),
            port=server.transport.sockets[0].getsockname()[1],  # type: ignore[union-attr]
        )
        started.set()
        await shared["stop"].wait()
        await server.shutdown()

    thread = threading.Thread(target=asyncio.run, args=(serve(),), name="pymodbus server")
    thread.start()
    try:
        assert started.wait(10.0)
        yield f"socket://127.0.0.1:{shared['port']}"
    finally:
        if "stop" in shared:
            shared["loop"].call_soon_threadsafe(shared["stop"].set)
        thread.join()
