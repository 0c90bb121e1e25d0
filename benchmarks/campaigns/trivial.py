"""Work that takes hardly any time, so that what is left is the machinery's."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from uvms_ocp.campaign.jobs import CampaignJob, Row, RunResult
from uvms_ocp.campaign.manifest import CampaignManifest, types_of
from uvms_ocp.version import __version__


@dataclass(frozen=True, kw_only=True, slots=True)
class Trivial(CampaignJob):
    """A row of the run's own number."""

    @property
    def columns(self) -> Mapping[str, type]:
        return {"square": int, "share": float}

    def head(self, run: int) -> Row:
        """Return what is known of a run before it is made."""
        return {"share": run / 7.0}

    def make(self, run: int) -> RunResult:
        """The row of a run."""
        return RunResult(
            row={
                **self.head(run),
                "square": run * run,
                "outcome": "completed",
                "success": True,
                "cause": "",
            }
        )


def identity_of(work: CampaignJob, runs: int) -> CampaignManifest:
    """Make the manifest by which the folder of such a campaign of so many runs knows it."""
    return CampaignManifest(
        name="trivial",
        package=__version__,
        runs=runs,
        seed=0,
        sampler="random",
        parameters={},
        columns=types_of(work),
        scenario={"function": "trivial"},
        variations={"values": []},
        records="none",
    )
