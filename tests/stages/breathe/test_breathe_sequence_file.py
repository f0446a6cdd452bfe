"""Sequences as TOML text."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest
from breathing_motions import affine_motions, every_form
from hypothesis import given, settings

from vhp_cli.errors import UsageError
from vhp_cli.stages.breathe.curves import Polynomial
from vhp_cli.stages.breathe.field import Field
from vhp_cli.stages.breathe.operations import Parameter
from vhp_cli.stages.breathe.sequence import Motion, Sequence
from vhp_cli.stages.breathe.sequence_file import format_sequence, parse_sequence

TEXT = format_sequence(every_form())


def test_every_form_comes_back_the_same() -> None:
    assert parse_sequence(TEXT) == every_form()
    assert format_sequence(parse_sequence(TEXT)) == TEXT


def test_a_cartilage_goes_with_the_rib_that_it_names() -> None:
    changed = parse_sequence(TEXT.replace("{ polynomial = [0.0, 0.45", "{ polynomial = [0.0, 0.9", 1))
    rib, cartilage = (changed.motion(name) for name in ("Rib 6 left", "Cartilage 6 left"))
    point = [[61.0, -41.0, -229.0]]
    assert rib.apply(point, 7.0) == pytest.approx(cartilage.apply(point, 7.0), abs=1e-12)
    assert abs(rib.apply(point, 7.0) - every_form().motion("Rib 6 left").apply(point, 7.0)).max() > 1.0


@given(affine_motions)
@settings(max_examples=40)
def test_any_motion_comes_back_the_same(motion: Motion) -> None:
    sequence = Sequence("s", (motion,))
    assert parse_sequence(format_sequence(sequence)) == sequence


def test_example_of_the_docs_is_read() -> None:
    page = (Path(__file__).parents[3] / "docs" / "breathe-sequence.md").read_text(encoding="utf-8")
    file, fields, blend = re.findall(r"```toml\n(.*?)```", page, re.S)
    skin = '[[motion]]\nname = "Skin"\nfields = ["chest", "descent"]\n'
    strip = '[[motion]]\nname = "Strip"\nfields = ["left_sixth_costal_cartilage"]\n'
    sequence = parse_sequence(file + fields + blend + skin + strip, "docs")
    assert [len(motion.operations) for motion in sequence.motions] == [3, 0, 0]
    assert [len(holder.operations) for holder in sequence.motion("Strip").fields[0].holders] == [3, 0]
    assert len(sequence.motion("Skin").fields) == 2


def test_coefficients_have_all_their_digits() -> None:
    rib = tomllib.loads(TEXT)["motion"][0]["operation"][0]
    assert rib["angle"]["polynomial"][2:4] == [1.234567890123456e-3, -1 / 3]
    assert rib["angle"]["unit"] == "deg"


def test_a_short_file_is_enough() -> None:
    text = """
    schema = "vhp-sequence/1"
    name = "short"
    [frame]
    length_unit = "mm"
    angle_unit = "deg"
    axes = "LPS"
    [sweep]
    variable = "breath"
    steps = 11
    period_s = 5
    [[motion]]
    name = "Heart"
    role = "heart"
    [[motion.operation]]
    kind = "move"
    z = { polynomial = [0, -1], unit = "mm" }
    """
    sequence = parse_sequence(text)
    assert sequence.motion("Heart").apply([[1.0, 2.0, 3.0]], 2.0).tolist() == [[1.0, 2.0, 1.0]]
    assert sequence.targets.lung_volume_change_l == 0.32


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('schema = "vhp-sequence/1"', 'schema = "vhp-sequence/9"', "schema is 'vhp-sequence/9'"),
        ('schema = "vhp-sequence/1"', "", "schema: missing"),
        ('schema = "vhp-sequence/1"', "schema = ", "not a TOML file"),
        ('axes = "LPS"', 'axes = "RAS"', "frame.axes: must be 'LPS', not 'RAS'"),
        ('length_unit = "mm"', 'length_unit = "m"', "frame.length_unit"),
        ("steps = 7", "steps = 7.5", "sweep.steps: must be a whole number"),
        ("steps = 7", "steps = true", "sweep.steps: must be a whole number"),
        ("steps = 7", "steps = 0", "number of steps"),
        ("period_s = 4.2", "period_s = nan", "sweep.period_s: must be a finite number"),
        ("period_s = 4.2", "period_s = 4.2\nperiod = 3", "sweep.period: no such entry"),
        ("number = 6", 'number = "six"', "motion[1].number: must be a whole number"),
        ('kind = "rotate"', 'kind = "turn"', "motion[1].operation[1].kind: must be scale, rotate or move, not 'turn'"),
        ('axis = "x"', 'axis = "w"', "motion[1].operation[1]: an axis is x, y or z"),
        (', unit = "deg"', ', unit = "rad"', "motion[1].operation[1].angle.unit: must be 'deg', not 'rad'"),
        ("{ polynomial = [0.0, 0.45", "{ base = 2.0, polynomial = [0.0, 0.45", "exactly one of polynomial"),
        ("{ polynomial = [0.0, 0.45", "{ polynomial = [0.1, 0.45", "at t = 0 instead of 0.0"),
        ("{ polynomial = [0.0, 0.45", '{ polynomial = ["a", 0.45', "angle.polynomial: must be a finite number"),
        (
            "origin = [32.07, 104.5, -215.3]",
            "origin = [32.07, 104.5]",
            "operation[1].origin: must have 3 numbers, not 2",
        ),
        ('fields = ["chest"]', 'fields = ["belly"]', "motion[4].fields: there is no field 'belly'"),
        ("x_taper = 60.0", "x_taper = 600.0", "field[2]: the tapers"),
        ('name = "descent"', 'name = "chest"', "a second field has the name 'chest'"),
        ('name = "Fat"', 'name = "Skin"', "two motions have the name 'Skin'"),
        ("displacements = [[0.0, 0.0, 0.0]", "displacements = [[0.0, 0.0]", "field[3].displacements"),
    ],
)
def test_mistakes_are_named_with_their_place(old: str, new: str, said: str) -> None:
    assert old in TEXT
    with pytest.raises(UsageError) as caught:
        parse_sequence(TEXT.replace(old, new, 1), "seq.toml")
    assert caught.value.message.startswith("seq.toml: ")
    assert said in caught.value.message


def test_a_name_stands_for_one_field() -> None:
    first = Field("chest", Parameter(Polynomial((0.0, 1.0))), (-200.0, 200.0), (0.0, 100.0), 0.0)
    second = Field("chest", Parameter(Polynomial((0.0, 2.0))), (-200.0, 200.0), (0.0, 100.0), 0.0)
    sequence = Sequence("s", (Motion("a", fields=(first,)), Motion("b", fields=(second,))))
    with pytest.raises(ValueError, match="two different fields have the name 'chest'"):
        format_sequence(sequence)
