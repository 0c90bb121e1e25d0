"""No URDF takes long or much memory, whatever stands in it."""

from __future__ import annotations

from pathlib import Path

import pytest

from uvms_ocp.errors import RobotDataError
from uvms_ocp.record.xml_file import MOST_ELEMENTS
from uvms_ocp.robot.urdf import read_urdf

_LINK = (
    "<link name='{0}'/><joint name='{0}' type='fixed'><parent link='{0}'/><child"
    " link='{1}'/></joint>"
)
BEYOND = {
    "elements in elements": ("<a>" * 100_000, "deeper than 32 levels"),
    "many elements": ("<robot>" + "<a/>" * (MOST_ELEMENTS + 1), "more than 50000 elements"),
    "laughter": (
        "<!DOCTYPE a [<!ENTITY b 'c'><!ENTITY d '&b;&b;'>]><a>&d;</a>",
        "a <!DOCTYPE> is not read",
    ),
    "no text": ("\udcff", "no text in UTF-8"),
    "no text in its encoding": (
        "<?xml version='1.0' encoding='us-ascii'?><robot name='\udcff'/>",
        "no text in us-ascii",
    ),
    **{
        f"encoding {name}": (
            f"<?xml version='1.0' encoding='{name}'?><robot name='a'/>",
            f"'{name}', which is not known; save",
        )
        for name in ("windows1252", "cp99999", "iso-8859-99", "euc-tw", "gb99")
    },
    "no end": ("<robot>", "the XML is broken"),
    "links": (
        "<robot name='a'>" + "".join(_LINK.format(i, i + 1) for i in range(3000)) + "</robot>",
        "3000 links; at",
    ),
}


@pytest.mark.parametrize("case", BEYOND)
def test_what_is_beyond_the_bounds_is_said_in_one_line(case: str, tmp_path: Path) -> None:
    text, message = BEYOND[case]
    path = tmp_path / "a.urdf"
    path.write_bytes(text.encode("utf-8", "surrogateescape"))
    with pytest.raises(RobotDataError, match=message) as caught:
        read_urdf(path, free_flyer=True)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 300
