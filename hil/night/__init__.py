"""One night carried out: begun, resumed, guarded, told of, replayed."""

from hil.night.remarks import Remarks
from hil.night.run import NightOutcome, resume_night, start_night

__all__ = ["NightOutcome", "Remarks", "resume_night", "start_night"]
