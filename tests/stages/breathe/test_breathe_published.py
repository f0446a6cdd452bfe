"""The published sequence: its tables, and what each erratum says of them."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.polynomial.polynomial import polyval

import vhp_cli
from vhp_cli.errors import UsageError
from vhp_cli.stages.breathe.bridges import bridge
from vhp_cli.stages.breathe.curves import Interpolant, Polynomial, Power
from vhp_cli.stages.breathe.operations import Move, Parameter, Rotate, Scale
from vhp_cli.stages.breathe.polynomials import fit_pinned
from vhp_cli.stages.breathe.published import errata, published_sequence
from vhp_cli.stages.breathe.sequence import Motion
from vhp_cli.stages.breathe.sequence_file import format_sequence, parse_sequence
from vhp_cli.stages.breathe.time import full_cycle

DATA = Path(vhp_cli.__file__).parent / "data"
PRINTED: dict[str, Any] = tomllib.loads((DATA / "vhp_female.toml").read_text(encoding="utf-8"))
STEPS: dict[str, Any] = tomllib.loads((DATA / "vhp_female_readings.toml").read_text(encoding="utf-8"))["unit_steps"]
PAIRS = {pair["n"]: pair for pair in PRINTED["ribs"]["pair"]}
TISSUES = {tissue["name"]: tissue for tissue in PRINTED["tissue"]}
READ = published_sequence()
AS_PRINTED = published_sequence(as_printed=True)
T = np.arange(1.0, 12.0)


def parameter(motion: str, name: str, *, printed: bool = False) -> Parameter:
    """Return a parameter by the name of its motion and one such as "theta" or "move y"."""
    found = (AS_PRINTED if printed else READ).motion(motion).operations
    if name in ("theta", "phi"):
        operation = found[("theta", "phi").index(name)]
        assert isinstance(operation, Rotate)
        return operation.angle
    kind, axis = name.split()
    for operation in found:
        if isinstance(operation, Rotate) and kind == "rotate" and operation.axis == axis:
            return operation.angle
        if (isinstance(operation, Scale) and kind == "scale") or (isinstance(operation, Move) and kind == "move"):
            return operation.parameters()[axis]
    raise KeyError(name)


def tables() -> Iterator[tuple[str, str, list[float], float]]:
    """Every printed table that is recommended: motion, parameter, values and the identity to add."""
    for n, pair in PAIRS.items():
        if pair["recommended"] == "table":
            for angle in ("theta", "phi"):
                for side in ("left", "right"):
                    yield f"Rib {n} {side}", angle, pair[f"{angle}_table"], 0.0
    for name, tissue in TISSUES.items():
        for transform in tissue.get("transform", ()):
            if transform["recommended"] == "table":
                identity = 1.0 if transform["op"] == "scale" else 0.0
                yield name, f"{transform['op']} {transform['axis']}", transform["table"], identity


TABLES = list(tables())


def decimals(values: list[float]) -> int:
    return max(len(repr(value).partition(".")[2]) for value in values)


@pytest.mark.parametrize(("motion", "name", "table", "identity"), TABLES, ids=[f"{m}, {n}" for m, n, *_ in TABLES])
def test_recommended_tables_are_reproduced(motion: str, name: str, table: list[float], identity: float) -> None:
    places = decimals(table)
    found = parameter(motion, name).curve(T[: len(table)]) - identity
    for t, value, printed in zip(T, found, table, strict=False):
        assert f"{value:.{places}f}" == f"{printed:.{places}f}", f"t = {t}"


def test_no_table_is_missed() -> None:
    """3 rib pairs, 12 of the pectorals, 2 of the erectors, 2 abdominal, 2 of the heart and 2 of the liver."""
    assert len(TABLES) == 3 * 4 + 12 + 2 + 2 + 2 + 2


@pytest.mark.parametrize("n", [n for n, pair in PAIRS.items() if pair["recommended"] == "poly"])
def test_recommended_polynomials_of_ribs_are_played(n: int) -> None:
    for angle in ("theta", "phi"):
        wanted = polyval(T, PAIRS[n][f"{angle}_poly"])
        for side in ("left", "right"):
            found = parameter(f"Rib {n} {side}", angle)
            assert float(found.curve(0.0)) == 0.0
            # Rib 11 and 5 are refitted through 0, from 0.004 deg; the others start there.
            assert np.abs(found.curve(T) - wanted).max() <= max(1e-12, 1.01 * abs(PAIRS[n][f"{angle}_poly"][0]))


def test_tables_are_monotone_between_their_values() -> None:
    for motion, name, *_ in TABLES:
        curve = parameter(motion, name).curve
        assert isinstance(curve, Interpolant) and curve.joining == "monotone"
        fine = curve(np.linspace(0.0, 11.0, 1101))
        assert (np.diff(fine) >= -1e-12).all() or (np.diff(fine) <= 1e-12).all()


def test_sequence_starts_at_rest_and_names_the_source() -> None:
    points = np.random.default_rng(1).uniform(-300, 300, (50, 3))
    for motion in READ.motions:
        assert np.array_equal(motion.apply(points, 0.0), points)
    assert "Tran" in READ.source and "2017" in READ.source
    assert (READ.steps, READ.targets.lung_volume_change_l, READ.targets.diaphragm_travel_mm) == (11, 0.32, 20.0)


def test_every_motion_has_a_role() -> None:
    ribs = {(motion.side, motion.number) for motion in READ.motions if motion.role == "rib"}
    assert ribs == {(side, n) for side in ("left", "right") for n in range(1, 13)}
    roles = [motion.role for motion in READ.motions if motion.role != "rib"]
    assert sorted(roles) == sorted(
        ["lung", *["pectoral"] * 4, *["erector"] * 2, "abdominal", "heart", "liver", "skin", "fat", "body"]
    )
    named = {(motion.role, motion.side, motion.number, motion.name_has) for motion in READ.motions}
    assert len(named) == len(READ.motions)


def test_ribs_go_up_and_outward_on_both_sides() -> None:
    for n in range(1, 13):
        for side, sign in (("left", 1.0), ("right", -1.0)):
            head = np.array(PAIRS[n][f"control_{side}"])
            tip = head + np.array([sign * 60.0, -120.0, -20.0])
            motion = READ.motion(f"Rib {n} {side}")
            assert motion.apply([head], 11.0)[0] == pytest.approx(head, abs=1e-9)
            lifted = alone(motion.operations[0], tip)
            assert lifted[2] > tip[2]
            turned = alone(motion.operations[1], tip)
            assert sign * turned[0] > sign * tip[0]


def alone(operation: Any, point: np.ndarray) -> np.ndarray:
    """Return where one operation takes a point at t = 11."""
    moved: np.ndarray = Motion("m", (operation,)).apply([point], 11.0)[0]
    return moved


def test_both_readings_come_back_from_their_file() -> None:
    for sequence in (READ, AS_PRINTED):
        assert parse_sequence(format_sequence(sequence)) == sequence


def test_unknown_sequence_is_refused() -> None:
    with pytest.raises(UsageError, match="no published sequence 'vhp-male'"):
        published_sequence("vhp-male")


# ---------------------------------------------------------------- the errata, one by one


def transform(tissue: str, op: str, axis: str) -> dict[str, Any]:
    return next(t for t in TISSUES[tissue]["transform"] if (t["op"], t["axis"]) == (op, axis))


def poly(tissue: str, op: str, axis: str, t: float | np.ndarray = T) -> Any:
    return polyval(t, transform(tissue, op, axis)["poly"])


def table(tissue: str, op: str, axis: str) -> np.ndarray:
    return np.array(transform(tissue, op, axis)["table"])


def rib(n: int, angle: str, form: str = "table") -> np.ndarray:
    return np.array(PAIRS[n][f"{angle}_table"]) if form == "table" else polyval(T, PAIRS[n][f"{angle}_poly"])


def e01() -> None:
    times = PRINTED["sweep"]["time_map"]
    assert [m.x for m in full_cycle()] == times["x_n"]
    assert [round(m.time_over_period, 4) for m in full_cycle()] == times["t_over_T"]


def e02() -> None:
    assert READ.steps == PRINTED["sweep"]["N"] == len(PRINTED["sweep"]["values"]) - 1
    assert len(full_cycle(READ.steps)) == PRINTED["sweep"]["frames_full_cycle"]


def e03() -> None:
    assert TISSUES["Stomach"]["data"] == "not printed"
    assert "stomach" not in {motion.role for motion in READ.motions}


def e04() -> None:
    for motion in READ.motions:
        kinds = [type(operation) for operation in motion.operations if not isinstance(operation, Rotate)]
        assert kinds == sorted(kinds, key=[Scale, Move].index)
    assert [type(o) for o in READ.motion("Pectoralis Minor Left").operations] == [Scale, Rotate, Move]


def e05() -> None:
    assert parameter("Lungs", "move y").curve(11.0) == pytest.approx(-3.0)
    assert parameter("Abdominal Muscles", "move z", printed=True).curve(11.0) == pytest.approx(1.0, abs=1e-4)


def e06() -> None:
    left, right = (TISSUES[f"Pectoralis Major {side}"]["cs"]["origin"][0] for side in ("Left", "Right"))
    assert (left + right) / 2 == pytest.approx(16.8, abs=0.1)
    assert READ.motion("Pectoralis Major Left").operations[0].frame.origin[0] == left


def e10() -> None:
    assert parameter("Lungs", "scale z", printed=True).curve == Power(1.0 + 0.1 / 11)
    assert parameter("Lungs", "scale z", printed=True).curve(11.0) == pytest.approx(1.10467, abs=5e-6)
    assert parameter("Lungs", "scale z").curve([5.5, 11.0]) == pytest.approx([1.05, 1.10])


def e11() -> None:
    def gain(printed: bool) -> float:
        scales = [parameter("Lungs", f"scale {axis}", printed=printed).curve(11.0) for axis in "xyz"]
        return float(PRINTED["limits"]["lung_volume_exhalation_L"] * (np.prod(scales) - 1.0))

    assert gain(printed=False) == pytest.approx(0.3207, abs=5e-5)
    assert gain(printed=True) == pytest.approx(0.282, abs=5e-4)


def e12() -> None:
    top, liver = TISSUES["Lungs"]["cs"]["origin"][2], TISSUES["Liver"]["cs"]["origin"][2]
    assert (top - liver) * 0.10467 == pytest.approx(25.3, abs=0.05)


def e13() -> None:
    assert READ.motion("Lungs").operations[0].frame.origin[0] == 0.0
    assert "E13" in READ.motion("Lungs").errata


def e20() -> None:
    assert len(PAIRS[1]["phi_table"]) == 10
    assert parameter("Rib 1 left", "phi").curve(11.0) == pytest.approx(2.32)
    assert "theta_table" not in PAIRS[2]
    assert parameter("Rib 2 left", "theta").curve(3.0) == pytest.approx(0.9999)


def e21() -> None:
    wrong = parameter("Rib 1 left", "phi", printed=True).curve
    assert (float(wrong(0.0)), float(wrong(11.0))) == pytest.approx((0.5939, 4.16), abs=5e-3)
    # Its coefficients, cut to 4 digits, are those of theta.
    refit = np.polynomial.polynomial.polyfit(T, rib(1, "theta"), 6)
    assert refit == pytest.approx(PAIRS[1]["phi_poly"], rel=2e-3)
    assert parameter("Rib 1 left", "phi").curve(0.0) == 0.0


def e22() -> None:
    assert rib(3, "theta") - rib(3, "theta", "poly") == pytest.approx(1.0)
    assert rib(3, "phi") - rib(3, "phi", "poly") == pytest.approx(0.16)


def e23() -> None:
    for n, theta in ((7, 0.2917), (8, 0.3333)):
        assert rib(n, "theta") - rib(n, "theta", "poly") == pytest.approx(theta, abs=7e-4)
        assert rib(n, "phi") - rib(n, "phi", "poly") == pytest.approx(0.4)


def e24() -> None:
    steps = np.array([1, 2, 3, 4, 5, 6, 8, 10, 12, 15, 16])
    refit = np.polynomial.polynomial.polyfit(np.arange(12.0), [0.0, *(0.4 * steps)], 6)
    assert [f"{value:.3g}" for value in refit] == [f"{value:.3g}" for value in PAIRS[5]["phi_poly"]]
    assert (rib(5, "theta", "poly") - rib(5, "theta"))[-1] == pytest.approx(2.70, abs=0.01)


def e25() -> None:
    assert np.abs(rib(6, "theta") - rib(6, "theta", "poly")).max() == pytest.approx(1.40, abs=0.01)
    assert np.abs(rib(6, "phi") - rib(6, "phi", "poly")).max() == pytest.approx(4.80, abs=0.01)


def e26() -> None:
    assert rib(10, "theta") == pytest.approx(rib(10, "phi", "poly"), abs=5e-4)
    assert rib(10, "phi") == pytest.approx(rib(10, "theta", "poly"), abs=5e-4)


def e27() -> None:
    assert (rib(11, "theta", "poly") - rib(11, "theta")).max() == pytest.approx(2.89, abs=0.01)
    assert (rib(11, "phi", "poly") - rib(11, "phi")).max() == pytest.approx(2.58, abs=0.01)


def e28() -> None:
    assert (rib(12, "theta") - rib(12, "theta", "poly"))[-1] == pytest.approx(2.75)
    assert (rib(12, "phi") - rib(12, "phi", "poly"))[-1] == pytest.approx(-1.10)


def e29() -> None:
    for n, angle, slope in ((6, "phi", 0.4), (9, "phi", 0.4), (10, "theta", 0.4), (12, "theta", 0.25)):
        assert parameter(f"Rib {n} left", angle, printed=True).curve == Polynomial((0.0, slope))


def e30() -> None:
    for n in PAIRS:
        if "theta_table" in PAIRS[n]:
            phi = rib(n, "phi")
            assert phi / rib(n, "theta")[: len(phi)] == pytest.approx(0.48 / n if n <= 4 else 9.6 / n, rel=2e-3)
            unit = STEPS[f"rib_{n}"]
            for angle in ("theta", "phi"):
                exact = [k * unit[f"{angle}_deg"] for k in unit["k"]]
                printed = rib(n, angle)
                assert [f"{v:.4f}" for v in exact[: len(printed)]] == [f"{v:.4f}" for v in printed]


def e31() -> None:
    assert all(pair["control_left"][0] > pair["control_right"][0] for pair in PAIRS.values())
    assert READ.motion("Rib 4 left").operations[1].frame.z_axis == (0.0, 0.0, 1.0)
    assert READ.motion("Rib 4 right").operations[1].frame.z_axis == (0.0, 0.0, -1.0)


def e32() -> None:
    for n, jump in ((3, 3), (5, 2), (7, 2), (8, 2)):
        unit = n / 6 if n <= 4 else n / 24
        assert rib(n, "theta")[0] / unit == pytest.approx(jump, abs=1e-3)


def e40() -> None:
    assert "sternum" not in {motion.role for motion in READ.motions}
    assert "sternum" in {motion.role for motion in AS_PRINTED.motions}


def e41() -> None:
    sternum = AS_PRINTED.motion("Sternum")
    below = np.array([TISSUES["Sternum"]["cs"]["origin"]]) - [0.0, 0.0, 100.0]
    moved = sternum.apply(below, 11.0) - below
    assert abs(moved[0, 0]) == pytest.approx(1.75, abs=0.01)
    assert moved[0, 1] == 0.0


def e42() -> None:
    origin = TISSUES["Sternum"]["cs"]["origin"]
    assert origin[2] / 0.6 == pytest.approx(-483.8, abs=0.1)
    assert origin[0] / 1.2 == pytest.approx(17.32, abs=0.01)
    assert origin[2] / 1.2 == pytest.approx(-241.9, abs=0.1)


def e50() -> None:
    old, new = np.array([50.0, 0.0, 0.0]), np.array([50.0, 1.0, 0.0])
    assert old @ new > 1.0  # of which there is no arc cosine
    operations = bridge(np.zeros(3), old, [11.0], np.zeros((1, 3)), new[None])
    angles = [o.angle.curve(11.0) for o in operations if isinstance(o, Rotate)]
    assert np.radians(np.hypot(*angles)) == pytest.approx(0.0200, abs=1e-4)


def cartilage(table_name: str, row: str) -> np.ndarray:
    return np.array(PRINTED["cartilage"][f"{table_name}_table"][row])


def e51() -> None:
    for row, n in (("left_5", 5), ("left_1", 1)):
        steps = np.diff(rib(n, "theta"))
        assert np.corrcoef(cartilage("expansion", row)[1:], steps)[0, 1] > 0.96


def e52() -> None:
    assert (cartilage("rotation", "left_1") == cartilage("rotation", "right_1")).all()
    assert (cartilage("rotation", "right_6")[1:10] == cartilage("rotation", "left_1")[2:]).all()


def e53() -> None:
    row = cartilage("expansion", "right_4").copy()
    rough = np.diff(row[1:], 2)
    row[1:3] *= -1.0
    assert np.abs(np.diff(row[1:], 2)).max() < 1e-4 < np.abs(rough).max()


def e54() -> None:
    assert np.prod(1.0 + cartilage("expansion", "right_6")) - 1.0 == pytest.approx(0.515, abs=1e-3)
    others = [np.prod(1.0 + cartilage("expansion", f"{s}_{n}")) - 1.0 for s in ("left", "right") for n in range(1, 6)]
    assert max(others) < 0.18


def e55() -> None:
    for name in ("rotation", "expansion"):
        rows = PRINTED["cartilage"][f"{name}_table"]
        assert all(values[0] == 0.0 for key, values in rows.items() if key != "ref")


def e56() -> None:
    assert PRINTED["cartilage"]["recommended"] == "rule"
    assert PRINTED["cartilage"]["scaling_vector"] == "-m_n / |m_n|"


def e57() -> None:
    assert "cartilage" not in {motion.role for motion in (*READ.motions, *AS_PRINTED.motions)}
    assert not any("poly" in key for key in PRINTED["cartilage"])


def e60() -> None:
    assert [TISSUES[f"Erector Spinae {side}"]["cs"]["origin"][0] for side in ("Left", "Right")] == [0.0, 0.0]
    left, right = (TISSUES[f"Pectoralis Major {side}"]["cs"]["origin"][1] for side in ("Left", "Right"))
    assert left - right > 100.0


def e61() -> None:
    wrong = poly("Pectoralis Minor Left", "rotate", "z", 11.0) - table("Pectoralis Minor Left", "rotate", "z")[-1]
    assert abs(wrong) == pytest.approx(0.383, abs=2e-3)
    assert parameter("Pectoralis Minor Left", "scale y", printed=True).curve(11.0) == pytest.approx(1.0154, abs=1e-4)
    assert parameter("Pectoralis Minor Left", "scale y").curve(11.0) == pytest.approx(0.9845, abs=5e-5)


def e62() -> None:
    printed = np.array(transform("Pectoralis Minor Right", "scale", "y")["poly"])
    assert polyval(11.0, printed) == pytest.approx(1.0965, abs=1e-4)
    printed[6] *= -1.0
    assert polyval(11.0, printed) == pytest.approx(0.9870, abs=1e-4)
    assert parameter("Pectoralis Minor Right", "scale y").curve(11.0) == pytest.approx(0.9827, abs=5e-5)


def e63() -> None:
    assert poly("Pectoralis Major Left", "move", "y", 0.0) == pytest.approx(-0.0387, abs=1e-4)
    off = poly("Pectoralis Major Left", "move", "y") - table("Pectoralis Major Left", "move", "y")
    assert np.abs(off).max() == pytest.approx(1.22, abs=0.01)


def e64() -> None:
    off = poly("Pectoralis Major Right", "move", "y") - table("Pectoralis Major Right", "move", "y")
    assert np.abs(off).max() == pytest.approx(1.10, abs=0.01)


def e65() -> None:
    left = np.prod([1.0 + table("Erector Spinae Left", "scale", axis)[-1] for axis in "xy"])
    right = np.prod([1.0 + table("Erector Spinae Right", "scale", axis)[-1] for axis in "xy"])
    assert (left, right) == pytest.approx((0.317, 0.608), abs=1e-3)
    for side in ("Left", "Right"):
        assert [type(o) for o in READ.motion(f"Erector Spinae {side}").operations] == [Move]


def e66() -> None:
    assert parameter("Erector Spinae Left", "move y", printed=True).curve(11.0) == pytest.approx(-40.8, abs=0.05)
    assert parameter("Erector Spinae Left", "move y").curve(11.0) == pytest.approx(0.70)


def e67() -> None:
    assert poly("Erector Spinae Right", "move", "y") == pytest.approx(-table("Erector Spinae Right", "move", "y"))
    assert parameter("Erector Spinae Right", "move y").curve(11.0) == pytest.approx(0.55)


def e68() -> None:
    values = [1.0, *(1.0 + table("Erector Spinae Left", "scale", "y"))]
    refit = np.polynomial.polynomial.polyfit(np.arange(12.0), values, 6)
    assert refit[0] == pytest.approx(transform("Erector Spinae Left", "scale", "y")["poly"][0], abs=5e-5)
    assert "+ 0.99756" in transform("Erector Spinae Left", "scale", "y")["poly_printed_table_3_2"]


def e69() -> None:
    assert table("Abdominal Muscles", "move", "z") == pytest.approx(-T / 11.0, abs=5.1e-5)
    assert table("Abdominal Muscles", "move", "y") == pytest.approx(-T / 11.0, abs=1e-4)
    assert parameter("Abdominal Muscles", "move y", printed=True).curve(11.0) == pytest.approx(-3.85)
    assert parameter("Abdominal Muscles", "move y").curve(11.0) == -1.0


def e70() -> None:
    for tissue, axis in (("Pectoralis Minor Left", "y"), ("Liver", "z")):
        assert (table(tissue, "scale", axis) < 0.0).all()
        found = parameter(tissue, f"scale {axis}").curve(T)
        assert found == pytest.approx(1.0 + table(tissue, "scale", axis), abs=5.1e-5)


def e71() -> None:
    """The left muscle's motion, mirrored, has the direction of the right one's."""
    left, right = (READ.motion(f"Pectoralis Minor {side}").operations[1] for side in ("Left", "Right"))
    assert left.frame.z_axis == (0.0, 0.0, 1.0) and right.frame.z_axis == (0.0, 0.0, -1.0)
    # Where a point in front of the origin goes along x: to the outside on both sides.
    fronts = [(turn, np.array(turn.frame.origin) - np.array([0.0, 50.0, 0.0])) for turn in (left, right)]
    moved = [float((alone(turn, front) - front)[0]) for turn, front in fronts]
    assert moved[0] > 0.0 > moved[1]


def e80() -> None:
    assert transform("Heart (muscle)", "move", "z")["poly"] == transform("Liver", "move", "z")["poly"]
    assert np.abs(poly("Heart (muscle)", "move", "z") - table("Heart (muscle)", "move", "z")).max() == pytest.approx(
        1.75, abs=0.01
    )
    assert np.abs(poly("Liver", "move", "z") - table("Liver", "move", "z")).max() == pytest.approx(0.73, abs=0.01)


def e81() -> None:
    heart, liver = poly("Heart (muscle)", "move", "y"), poly("Liver", "move", "y")
    assert np.abs(heart - table("Heart (muscle)", "move", "y")).max() == pytest.approx(0.96, abs=0.01)
    assert heart == pytest.approx(liver, abs=0.2)


def e82() -> None:
    y, z = table("Liver", "move", "y").copy(), table("Liver", "move", "z")
    assert z[1] / y[1] == pytest.approx(0.45)
    y[1] = -0.08
    assert z / y == pytest.approx(4.5)
    refit = np.polynomial.polynomial.polyfit(np.arange(12.0), [0.0, *y], 6)
    assert polyval(T, refit) == pytest.approx(poly("Liver", "move", "y"), abs=2.5e-3)
    # The polynomial is recommended: within its residual of the corrected table, and from rest.
    assert parameter("Liver", "move y").curve(T) == pytest.approx(y, abs=0.045)
    assert parameter("Liver", "move y").curve(0.0) == 0.0


def e83() -> None:
    printed = np.array(transform("Liver", "scale", "z")["poly"])
    assert polyval(11.0, printed) == pytest.approx(0.9942, abs=1e-4)
    printed[4] = 2.277e-5
    assert polyval(11.0, printed) == pytest.approx(0.9322, abs=2e-4)
    assert parameter("Liver", "scale z").curve(11.0) == pytest.approx(0.932)


def e84() -> None:
    moved = READ.motion("Heart (muscle)").apply([[0.0, 0.0, 0.0]], 11.0)
    assert np.linalg.norm(moved) == pytest.approx(12.2, abs=0.05)
    assert PRINTED["literature_motion"]["heart_mm"] == [2, 8]


def chest(printed: bool) -> Any:
    return (AS_PRINTED if printed else READ).motion("Skin").fields[0]


def e90() -> None:
    assert np.diff(chest(printed=True).x_window)[0] == pytest.approx(32.1)
    assert np.diff(chest(printed=False).x_window)[0] == pytest.approx(314.7)
    assert np.mean(chest(printed=False).x_window) == pytest.approx(16.05)


def e91() -> None:
    low, high = chest(printed=True).z_window
    assert high - low == pytest.approx(180.0)
    z = np.linspace(low, high, 19)
    points = np.stack([np.full(19, 157.0), np.full(19, -50.0), z], axis=1)
    in_degrees = -10.0 / 11.0 * 4.0 * np.sin(np.radians(z - low))
    assert chest(printed=True).displacement(points, 4.0)[:, 1] == pytest.approx(in_degrees, abs=1e-12)


def e92() -> None:
    edge = [[-141.2, 0.0, -240.6], [173.3, 0.0, -240.6], [16.0, 63.9, -240.6]]
    assert (chest(printed=False).weight(edge) < 1e-4).all()
    assert (chest(printed=True).weight([[141.4, 0.0, -240.6], [173.3, 63.9, -240.6]]) > 0.99).all()


def e93() -> None:
    half = READ.motion("Skin").apply([[16.05, -60.0, -240.6]], 5.5)
    assert half[0] == pytest.approx([16.05, -65.0, -240.6])


def e94() -> None:
    assert READ.motion("Skin").fields == READ.motion("Fat").fields == READ.motion("Average body").fields
    assert "fat" not in {motion.role for motion in AS_PRINTED.motions}


def e95() -> None:
    width, height = np.diff(chest(printed=False).x_window)[0], np.diff(chest(printed=False).z_window)[0]
    bulge = 10.0 * width * height * 2.0 / np.pi * 1e-6
    assert bulge == pytest.approx(0.361, abs=1e-3)
    assert PRINTED["limits"]["mass_variation_reported_g"] / (1000.0 * PRINTED["model"]["mass_kg"]) < 0.001


CHECKS: dict[str, Callable[[], None]] = {
    name.upper(): check for name, check in globals().items() if len(name) == 3 and name[0] == "e" and name[1:].isdigit()
}


@pytest.mark.parametrize("code", sorted(errata()))
def test_erratum(code: str) -> None:
    """Each entry of the list holds of the printed numbers and of the reading."""
    CHECKS[code]()


def test_every_erratum_that_is_named_is_listed_and_the_other_way_round() -> None:
    def named(value: object, key: str = "") -> Iterator[str]:
        if isinstance(value, dict):
            for inner, item in value.items():
                yield from named(item, "errata" if key == "errata_by_row" else inner)
        elif isinstance(value, list):
            for item in value:
                yield from named(item, key)
        elif key == "errata":
            yield str(value)

    assert set(named(PRINTED)) == set(errata()) == set(CHECKS)
    for entry in errata().values():
        assert entry.printed and entry.read and entry.ref and entry.basis in ("verified", "deduced", "judgement")


def test_the_sequence_names_the_errata_of_what_it_plays() -> None:
    def codes(sequence: Any) -> set[str]:
        found = set(sequence.errata)
        for motion in sequence.motions:
            found |= set(motion.errata)
            for operation in motion.operations:
                for item in operation.parameters().values():
                    found |= set(item.errata)
            for field in motion.fields:
                found |= set(field.amplitude.errata)
        return found

    # What concerns the cartilage tables row by row, and the origins of tissues that are not played, has no motion.
    assert set(errata()) - codes(AS_PRINTED) == {"E06", "E52", "E53", "E54"}
    assert codes(READ) < codes(AS_PRINTED)
    assert set(errata()) - codes(READ) <= {"E06", "E52", "E53", "E54", "E40", "E41", "E42", "E65", "E68"}


def test_printed_polynomials_are_played_as_printed() -> None:
    for name, tissue in TISSUES.items():
        for entry in tissue.get("transform", ()):
            if "poly" in entry:
                found = parameter(name, f"{entry['op']} {entry['axis']}", printed=True).curve
                assert found(T) == pytest.approx(polyval(T, entry["poly"]))
    for n in PAIRS:
        for angle in ("theta", "phi"):
            assert parameter(f"Rib {n} right", angle, printed=True).curve(T) == pytest.approx(rib(n, angle, "poly"))


def test_pinned_refit_is_near_the_polynomial_that_misses_rest() -> None:
    printed = Polynomial(tuple(PAIRS[11]["theta_poly"]))
    pinned = fit_pinned(T, printed(T), 0.0)
    assert pinned.coefficients == pytest.approx(parameter("Rib 11 left", "theta").curve.coefficients)
