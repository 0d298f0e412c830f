"""What looking at a bench finds: one thing each."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Finding:
    """One thing that was looked at. `good` is False where a night must not begin like this.

    `advice` says what to do about what is wrong, or about what is worth knowing; empty where there is nothing to do.
    """

    subject: str
    good: bool
    message: str
    advice: str = ""
