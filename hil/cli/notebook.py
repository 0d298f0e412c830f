"""What notebooks and scripts ask: a folder of measured data, with the commands' questions as methods.

import hil
night = hil.read_night("night-014")
night.solve().to_dataframe()

Each answer is the command's own: its `document` is what `--json` prints, its table what a terminal shows.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from drivers.outside import library
from hil.campaign import Campaign
from hil.cli import coefficients, data, night
from hil.cli import model as of_models
from hil.cli.answer import Answer, Picture
from hil.cli.watch import look_at
from hil.config import load_bench
from hil.errors import InputError
from hil.records.export import open_source
from hil.records.reader import JOURNAL_NAME, is_night
from procedures.words import counted, numbered

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

__all__ = ["Answer", "Measured", "Night", "Picture", "load_bench", "read_campaign", "read_night"]


class Measured:
    """The campaign folder or night `folder`, and what was measured in it as `campaign`.

    A method has its command's options and raises what ends that command: `InputError` with one sentence where the data
    or an option cannot be used, `Damaged` where a night's records are not what was written.
    """

    def __init__(self, folder: Path | str) -> None:
        self.folder = Path(folder)
        self.campaign: Campaign = open_source(self.folder)

    def solve(self, model: str | None = None) -> Answer:
        """Solve every self-calibration, as `hil solve`: parameters, their uncertainty, what repeats show."""
        return data.solve(self.folder, model)

    def thermal(self, model: str | None = None, *, highest_order: int = 5, apart: str | None = None) -> Answer:
        """Fit every parameter against temperature, as `hil thermal`; `apart` such as "2 degC"."""
        return coefficients.thermal(self.folder, model, highest_order, apart)

    def allan(
        self,
        sensor: int | None = None,
        channel: str | None = None,
        *,
        collect: int | None = None,
        reach: str | None = None,
    ) -> Answer:
        """Say what the noise is made of, as `hil allan`; `reach` such as "0.5 deg/hr"."""
        return coefficients.allan(self.folder, channel, sensor, collect, reach=reach)

    def scatter(self) -> Answer:
        """Tell what makes repeats scatter, as `hil scatter`."""
        return coefficients.scatter(self.folder)

    def budget(
        self, bench: str | None = None, model: str | None = None, *, run: int | None = None, draws: int = 100_000
    ) -> Answer:
        """Say what each source of error contributes to each parameter, as `hil budget`."""
        return coefficients.budget(str(self.folder), bench, model, run, draws=draws)

    def visibility(self, model: str | None = None) -> Answer:
        """Say which effects these collects can see, as `hil visibility`."""
        return of_models.visibility(str(self.folder), model=model)

    def reconcile(self, model: str, out: Path | None = None, *, alpha: float = 0.05) -> Answer:
        """Find what the model lacks, as `hil reconcile`; its files are written only where `out` names a folder."""
        return of_models.reconcile(self.folder, model, out, alpha)

    def plot_collect(self, collect: int) -> Picture:
        """Draw the samples of one collect, as `hil plot series`."""
        from hil.report.plots import collect_series, draw_series

        numbers = {number: rows.conditions.collect for number, rows in self.campaign.sensors.items()}
        sensor = next((number for number, its in numbers.items() if collect in its), next(iter(numbers)))
        return Picture(draw_series(collect_series(self.folder, sensor=sensor, collect=collect)))

    def to_dataframe(self) -> pd.DataFrame:
        """Return one row per collect and sensor, with the columns of collects.csv and `simulated`.

        Raises `InputError` where pandas is not installed.
        """
        from hil.campaign.writer import columns_of

        frame: pd.DataFrame = library("pandas", "notebook").DataFrame(columns_of(self.campaign))
        frame["simulated"] = self.campaign.simulated
        frame.attrs = {"title": self.campaign.title, "simulated": self.campaign.simulated}
        return frame

    def to_xarray(self) -> xr.Dataset:
        """Return the same columns over `collect`; raise `InputError` where pandas or xarray is not installed."""
        library("xarray", "notebook")
        dataset: xr.Dataset = self.to_dataframe().set_index("collect").to_xarray()
        return dataset.assign_attrs(title=self.campaign.title, simulated=int(self.campaign.simulated))

    def __repr__(self) -> str:
        collects = sum(len(each.conditions) for each in self.campaign.sensors.values())
        mark = "  SIMULATED" if self.campaign.simulated else ""
        known = f"{counted(collects, 'average')} of {numbered('sensor', self.campaign.sensors)}"
        return f"{self.campaign.title}{mark}: {known}, in {self.folder}"


class Night(Measured):
    """A night's folder, which also knows how it stands."""

    def status(self) -> Mapping[str, Any]:
        """Return how the night stands, as `hil status --json`."""
        return look_at(self.folder)[0]

    def verify(self) -> Answer:
        """Check every step, block and hash, as `hil verify`."""
        return night.verify(self.folder)

    def plot_temperatures(self) -> Picture:
        """Draw chamber and unit through the night, as `hil plot temperatures`."""
        from hil.report.plots import draw_temperatures

        return Picture(draw_temperatures(self.folder))


def read_campaign(folder: Path | str) -> Measured:
    """Read a campaign folder, or a night as one; raise `InputError` in one sentence where it is neither."""
    return Measured(folder)


def read_night(folder: Path | str) -> Night:
    """Read a night's folder; raise `InputError` where it is none, `Damaged` where it is not what was written."""
    if not is_night(Path(folder)):
        raise InputError(f"{folder}: no night (no {JOURNAL_NAME}); a campaign folder is read by hil.read_campaign")
    return Night(folder)
