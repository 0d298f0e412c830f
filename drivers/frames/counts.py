"""What a stream has lost, and what it could not read."""

from dataclasses import dataclass


@dataclass(frozen=True)
class StreamCounts:
    """What happened to the bytes; counts add. `overflow_bytes` could not be kept while nobody read."""

    ok: int = 0
    bad_checksum: int = 0
    bad_delimiter: int = 0
    unknown_id: int = 0
    skipped_bytes: int = 0
    resyncs: int = 0
    lost: int = 0
    duplicate: int = 0
    timed_out: int = 0
    overflow_bytes: int = 0

    def __add__(self, other: "StreamCounts") -> "StreamCounts":
        mine, theirs = vars(self), vars(other)
        return StreamCounts(**{name: mine[name] + theirs[name] for name in mine})
