"""A bench's table becomes a curve in newtons, by what it says itself of its unit and of its
sheets.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml
from typer.testing import CliRunner

from uvms_ocp.cli.commands import app

PWM = np.arange(1100, 1901, 50)
FORCE = 5.0 * np.sign(PWM - 1500.0) * ((PWM - 1500.0) / 400.0) ** 2  # [kgf]


def curve_of(*arguments: str) -> tuple[np.ndarray, str]:
    shown = CliRunner().invoke(
        app, ["thruster-curve", *arguments, "--pwm", "PWM", "--thrust", "Force"]
    )
    assert shown.exit_code == 0, shown.stderr
    return np.array(yaml.safe_load(shown.stdout)["curve"]), " ".join(shown.stderr.split())


@pytest.mark.parametrize(
    ("header", "given", "newtons"),
    [
        *(
            ("Force (Kg f)", [], 9.80665),
            ("Force [kgf]", [], 9.80665),
            ("Force [N]", [], 1.0),
            ("Force", [], 1.0),
        ),
        *(("Force [gf]", ["--unit", "kgf"], 9.80665), ("Force", ["--unit", "lbf"], 4.448222)),
    ],
)
def test_thrust_is_in_the_unit_that_is_given_or_else_as_the_header_says(
    header: str, given: list[str], newtons: float, tmp_path: Path
) -> None:
    rows = "\n".join(f"{pwm},{force}" for pwm, force in zip(PWM, FORCE, strict=True))
    (tmp_path / "bench.csv").write_text(f"PWM (us),{header}\n{rows}\n")
    curve, message = curve_of(str(tmp_path / "bench.csv"), *given)
    np.testing.assert_allclose(curve, np.column_stack([PWM, newtons * FORCE]), rtol=1e-3)
    assert message.startswith("thrust in ")


def test_a_unit_that_is_none_of_thrust_is_refused(tmp_path: Path) -> None:
    (tmp_path / "bench.csv").write_text("PWM,Force (W)\n1500,0\n1900,40\n")
    shown = CliRunner().invoke(
        app, ["thruster-curve", str(tmp_path / "bench.csv"), "--pwm", "PWM", "--thrust", "Force"]
    )
    assert "unknown unit 'W'; known: N, kgf, gf, lbf" in str(shown.exception)


def test_sheets_of_voltages_are_one_table(tmp_path: Path) -> None:
    openpyxl = pytest.importorskip("openpyxl", reason='needs pip install "uvms-ocp[files]"')
    book = openpyxl.Workbook()
    book.active.append(["How this was measured"])
    for volts in (12.0, 16.0):
        sheet = book.create_sheet(f"{volts:g} V")
        for row in [
            ["PWM", "Voltage (V)", "Force (kgf)"],
            *zip(PWM.tolist(), [volts] * len(PWM), volts / 12.0 * FORCE, strict=True),
        ]:
            sheet.append(list(row))
    book.save(tmp_path / "bench.xlsx")
    first, message = curve_of(str(tmp_path / "bench.xlsx"))
    np.testing.assert_allclose(first[:, 1], 9.80665 * FORCE, rtol=1e-3)
    assert "sheet 12 V of Sheet, 12 V, 16 V" in message
    both_sheets = ["--sheet", "12 V", "--sheet", "16 V", "--voltage", "Voltage", "--at", "14"]
    np.testing.assert_allclose(
        curve_of(str(tmp_path / "bench.xlsx"), *both_sheets)[0][:, 1],
        14.0 / 12.0 * 9.80665 * FORCE,
        rtol=1e-3,
    )


@pytest.mark.parametrize("volts", [(15.0, 17.0), (12.0, 16.0)])
def test_a_table_of_several_voltages_asks_for_one(
    volts: tuple[float, float], tmp_path: Path
) -> None:
    lines = ["PWM,Voltage (V),Force"]
    for pwm, force in zip(PWM, FORCE, strict=True):
        lines += [f"{pwm},{voltage},{voltage * force}" for voltage in volts]
    path = tmp_path / "bench.csv"
    path.write_text("\n".join(lines))
    command = ["thruster-curve", str(path), "--pwm", "PWM", "--thrust", "Force"]
    refused = str(CliRunner().invoke(app, command).exception)
    assert f"is {volts[0]:g} to {volts[1]:g}; choose one: --voltage 'Voltage" in refused
    chosen, _ = curve_of(str(path), "--voltage", "Voltage", "--at", f"{volts[1]:g}")
    np.testing.assert_allclose(chosen[:, 1], volts[1] * FORCE, rtol=1e-3)


def test_a_voltage_that_sags_under_load_is_one(tmp_path: Path) -> None:
    rows = [f"{pwm},{16.0 - 0.04 * abs(f)},{f}" for pwm, f in zip(PWM, FORCE, strict=True)]
    (tmp_path / "bench.csv").write_text("PWM,Voltage,Force\n" + "\n".join(rows))
    curve, _ = curve_of(str(tmp_path / "bench.csv"))
    np.testing.assert_allclose(curve[:, 1], FORCE, rtol=1e-3)
