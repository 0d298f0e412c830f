"""Any IMU by description: the frame language, the decoder and the encoder.

description = load_description("configs/imus/mfs.yaml")
decoder = StreamDecoder(description)
decoded = decoder.feed(data, arrival_s=clock.now())
decoded["sample"].column("rate_A1")  # deg/hr, shape (n,)
decoded.counts.lost
"""

from drivers.frames.batch import FrameBatch
from drivers.frames.decoded import Decoded
from drivers.frames.decoder import StreamDecoder
from drivers.frames.description import DescriptionError, StreamDescription, load_description, parse_description
from drivers.frames.encoder import encode
from drivers.frames.layout import FrameLayout

__all__ = [
    "Decoded",
    "DescriptionError",
    "FrameBatch",
    "FrameLayout",
    "StreamDecoder",
    "StreamDescription",
    "encode",
    "load_description",
    "parse_description",
]
