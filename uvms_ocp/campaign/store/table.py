"""The finished rows of a campaign as a table."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from uvms_ocp.arguments import checked
from uvms_ocp.campaign.store.identity import read_identity
from uvms_ocp.campaign.store.parts import read_rows


@checked
def read_table(folder: Path) -> Any:
    """A pandas.DataFrame of all finished runs of the campaign in a folder, by run number; also while it goes on.

    Raises `InvalidInput` where there is none, and `NotInstalled` without the extra ``uvms-ocp[campaign]``.
    """
    identity = read_identity(folder)
    return read_rows(folder, identity.types).to_pandas()
