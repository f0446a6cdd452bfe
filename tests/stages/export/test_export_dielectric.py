"""Permittivity and conductivity of tissues against published values."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest

import vhp_cli
from vhp_cli.errors import UsageError
from vhp_cli.stages.export.dielectric import dielectric, frequency_text, material_names, parse_frequency

# Of the calculator of IFAC-CNR, as printed in table 3 of doi:10.1186/s12938-018-0473-9 (conductivity in S/m, relative
# permittivity at 10, 100, 200, 400 and 1000 kHz).
PUBLISHED_KHZ = {
    "Skin (Dry)": [
        (0.00020, 1133.6), (0.00045, 1119.2), (0.00105, 1104.8), (0.00305, 1076.3), (0.0132, 990.76)
    ],
    # The conductivity at 200 kHz is a misprint there (0.1135, between 0.0658 and 0.1635).
    "Skin (Wet)": [(0.0029, 29010), (0.0658, 15357), (None, 8849.2), (0.1635, 4514.6), (0.2214, 1832.8)],
    "Fat (Not Infiltrated)": [
        (0.0238, 1085.3), (0.0244, 92.885), (0.0246, 56.015), (0.0248, 38.134), (0.0251, 27.222)
    ],
    "Muscle": [(0.3408, 25909), (0.3619, 8089.2), (0.3841, 6377.7), (0.4278, 4339.3), (0.5027, 1836.4)],
    "Bone (Cortical)": [
        (0.0204, 521.64), (0.0208, 227.64), (0.0211, 203.74), (0.0218, 182.27), (0.0243, 144.51)
    ],
}  # fmt: skip
KHZ = (10, 100, 200, 400, 1000)


@pytest.mark.parametrize("material", PUBLISHED_KHZ)
def test_published_values_below_1_mhz(material):
    for khz, (conductivity, permittivity) in zip(KHZ, PUBLISHED_KHZ[material], strict=True):
        found = dielectric(material, khz * 1e3)
        # Permittivity is printed with five digits, conductivity with four decimals, partly cut off instead of rounded.
        assert found.permittivity == pytest.approx(permittivity, rel=5e-5), khz
        assert conductivity is None or found.conductivity == pytest.approx(conductivity, abs=6e-5), khz


def test_published_values_at_100_mhz():
    """Muscle, by the calculator of IFAC-CNR."""
    found = dielectric("Muscle", 100e6)
    assert found.permittivity == pytest.approx(65.97, abs=0.005)
    assert found.conductivity == pytest.approx(0.708, abs=0.0005)


def test_lens_is_the_mean_of_cortex_and_nucleus():
    cortex, nucleus, lens = (dielectric(name, 1e9) for name in ("Lens Cortex", "Lens Nucleus", "Lens"))
    assert lens.permittivity == pytest.approx((cortex.permittivity + nucleus.permittivity) / 2)
    assert lens.conductivity == pytest.approx((cortex.conductivity + nucleus.conductivity) / 2)


@pytest.mark.parametrize("material", material_names())
def test_every_material_is_passive_and_disperses(material):
    """Permittivity falls and conductivity rises with frequency, as of any relaxation, by Kramers and Kronig."""
    found = [dielectric(material, 10.0**power) for power in range(1, 12)]
    assert all(value.permittivity >= 1 and value.conductivity > 0 for value in found)
    assert sorted((value.permittivity for value in found), reverse=True) == [value.permittivity for value in found]
    assert sorted(value.conductivity for value in found) == [value.conductivity for value in found]


def test_the_table_is_whole():
    table = tomllib.loads((Path(vhp_cli.__file__).parent / "data" / "electromagnetic.toml").read_text())
    assert set(table) == set(material_names()) and len(table) == 45
    for name, row in table.items():
        if "mean_of" in row:
            assert set(row["mean_of"]) <= set(table), name
            continue
        assert set(row) == {"eps_inf", "delta", "tau", "alpha", "sigma"}
        assert {len(row[key]) for key in ("delta", "tau", "alpha")} == {4}
        assert all(0 <= alpha < 0.5 for alpha in row["alpha"]) and row["sigma"] >= 0


@pytest.mark.parametrize(
    ("text", "hertz", "shown"),
    [
        ("300MHz", 300e6, "300 MHz"), ("2.45 GHz", 2.45e9, "2.45 GHz"), ("3e8", 3e8, "300 MHz"),
        ("10kHz", 1e4, "10 kHz"), ("50", 50.0, "50 Hz"), ("1.5e3 kHz", 1.5e6, "1.5 MHz"), ("100 GHz", 1e11, "100 GHz"),
    ],
)  # fmt: skip
def test_frequencies(text, hertz, shown):
    assert parse_frequency(text) == pytest.approx(hertz, rel=1e-15)
    assert frequency_text(parse_frequency(text)) == shown


@pytest.mark.parametrize("text", ["", "MHz", "300 mhz", "1 Hz", "101GHz", "-3e8", "nan", "inf", "1.2.3", "300 MHz x"])
def test_what_is_no_frequency(text):
    with pytest.raises(UsageError, match="expected 10 Hz to 100 GHz"):
        parse_frequency(text)


def test_out_of_range():
    with pytest.raises(UsageError, match="not at 5 Hz"):
        dielectric("Muscle", 5.0)
    with pytest.raises(KeyError):
        dielectric("Unobtainium", 1e9)
