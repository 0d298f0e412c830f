"""Who is asked: a function of this installation, or of another checkout, which is asked in a process of its own.

[LABEL=]MODULE:FUNCTION[@CHECKOUT]        hil.reconcile:reconcile      before=hil.reconcile:reconcile@../before
"""

from __future__ import annotations

import importlib
import json
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

TODAY = "hil.reconcile:reconcile"


def label(engine: str) -> str:
    """What an engine is called in the tables."""
    return engine.partition("=")[0]


def answer(engine: str, folder: Path, model: str, alpha: float) -> dict[str, Any]:
    """What an engine says of a campaign folder, as a document, and the `seconds` that it took without reading."""
    where, _, checkout = engine.rpartition("=")[2].partition("@")
    if checkout:
        return _elsewhere(where, Path(checkout).resolve(), folder, model, alpha)
    from hil.campaign.reader import read_campaign

    module, _, function = where.partition(":")
    reconcile, campaign = getattr(importlib.import_module(module), function), read_campaign(folder)
    begun = time.perf_counter()
    result = reconcile(campaign, model, alpha=alpha)
    seconds = time.perf_counter() - begun
    return {**(result if isinstance(result, dict) else result.document()), "seconds": seconds}


def _elsewhere(where: str, checkout: Path, folder: Path, model: str, alpha: float) -> dict[str, Any]:
    """Ask the same of another checkout's packages. What it raises is raised here, by its last line."""
    environment = {**os.environ, "PYTHONPATH": str(checkout)}
    command = [sys.executable, __file__, where, str(folder), model, repr(alpha)]
    done = subprocess.run(command, cwd=checkout, env=environment, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(done.stderr.strip().rpartition("\n")[2])
    return dict(json.loads(done.stdout.rpartition("\n")[2]))


if __name__ == "__main__":
    # The folder of this file is first on the path of a script, and is no package's root.
    sys.path.pop(0)
    _, asked, campaign_folder, named, rate = sys.argv
    print("\n" + json.dumps(answer(asked, Path(campaign_folder), named, float(rate))), end="")
