"""A frame description in words: what `hil frames check` says about a file that can be used.

print(explain_frames(load_description("configs/imus/stim300.yaml")))
"""

from collections.abc import Iterator

from drivers.frames.checksum_kinds import CrcKind, NoChecksum
from drivers.frames.description import StreamDescription
from hil.files.text import filled

_NAMES = {
    (32, 0x04C11DB7, 0xFFFFFFFF, False, False, 0): "CRC-32/MPEG-2",
    (32, 0x04C11DB7, 0xFFFFFFFF, True, True, 0xFFFFFFFF): "CRC-32/ISO-HDLC",
    (16, 0x1021, 0, False, False, 0): "CRC-16/XMODEM",
    (16, 0x1021, 0x1D0F, False, False, 0): "CRC-16/SPI-FUJITSU",
    (16, 0x1021, 0xFFFF, False, False, 0): "CRC-16/IBM-3740",
}
_TYPES = {"fp12.20": "12.20 fixed point", "fp16.32": "16.32 fixed point", "item": "in the item's number format"}
_TYPES |= {"f16": "half precision", "f32": "single precision", "f64": "double precision"}


def explain_frames(description: StreamDescription) -> str:
    """Return the description in words: the stream, each frame with its fields, what they are for, and what is weak."""
    told = {"names": _NAMES, "types": _TYPES, "warnings": list(_warnings(description))}
    return filled("hil.bench", "frames_check.txt.j2", r=description, **told).rstrip("\n") + "\n"


def _warnings(description: StreamDescription) -> Iterator[str]:
    for name, frame in description.frames.items():
        kind = frame.checksum
        if frame.parts:
            continue
        if isinstance(kind, NoChecksum) and (frame.text is None or not frame.text.checksums):
            yield f"{name} has no checksum: damage in it goes unnoticed"
        elif frame.text is None and not isinstance(kind, CrcKind) and not kind.confirm:
            yield f"{name}: so weak a checksum matches by chance; with checksum.confirm, the next frame is asked too"
        if frame.counter is not None:
            frames = frame.counter.modulus // frame.counter.step
            seconds = frames / description.sample_rate_hz
            if frames <= 256:
                yield f"{name}: the counter comes round in {seconds:.3g} s; longer outages are told by the clock alone"
    roles = description.roles
    if roles is not None:
        frame = description.frames[roles.frame]
        if frame.counter is None and frame.time is None:
            yield f"{roles.frame} has neither counter nor time: a lost frame shows only in when the others arrive"
