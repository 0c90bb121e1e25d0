"""Read recordings by the mappings that are proposed for them."""

from __future__ import annotations

from pathlib import Path

import yaml

from uvms_ocp.identification.channel_mapping import RecordingMapping
from uvms_ocp.identification.mapped_recordings import mapped_recording
from uvms_ocp.identification.proposed_mapping import propose_mapping
from uvms_ocp.identification.recording import Recording


def read_as_proposed(path: Path) -> Recording:
    """Read a file by the mapping that is proposed for it."""
    mapping = RecordingMapping.model_validate(yaml.safe_load(propose_mapping(path)))
    return mapped_recording(path, mapping)
