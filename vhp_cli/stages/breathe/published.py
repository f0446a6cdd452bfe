"""The published sequence of the VHP-Female model (Tran 2017), as recommended or as printed."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from vhp_cli.errors import UsageError
from vhp_cli.stages.breathe.curves import Curve, Interpolant, Polynomial, Power
from vhp_cli.stages.breathe.field import Field
from vhp_cli.stages.breathe.operations import (
    LocalFrame,
    Move,
    Operation,
    Parameter,
    Rotate,
    Scale,
    Triple,
    triple,
)
from vhp_cli.stages.breathe.polynomials import fit_pinned, residual
from vhp_cli.stages.breathe.sequence import Motion, Sequence, Targets
from vhp_cli.stages.breathe.time import PERIOD_S

NAMES = ("vhp-female",)

_SOURCE = (
    "A. L. Tran, Development of the VHP-Female CAD model including Dynamic Breathing Sequence, M.S. thesis, "
    "Worcester Polytechnic Institute, 2017, chapter 3 and appendix A"
)
# What the names of the tissues are in the file of readings.
_READINGS = {
    "Pectoralis Minor Left": "pect_minor_left",
    "Pectoralis Minor Right": "pect_minor_right",
    "Pectoralis Major Left": "pect_major_left",
    "Pectoralis Major Right": "pect_major_right",
    "Erector Spinae Left": "erector_left",
    "Heart (muscle)": "heart",
    "Liver": "liver",
}
_ROLES = {
    "pectoralis_minor": ("pectoral", "minor"),
    "pectoralis_major": ("pectoral", "major"),
    "erector_spinae": ("erector", ""),
    "lungs": ("lung", ""),
}
_SHELLS = (("Skin", "skin"), ("Fat", "fat"), ("Average body", "body"))
# Scale and rotation share an origin that stands still, then the move (E04).
_ORDER = ("scale", "rotate", "move")


@dataclass(frozen=True, slots=True)
class Erratum:
    """One entry of the list of errata.

    Parameters
    ----------
    code
        Its name, such as ``"E21"``.
    ref
        Where in the thesis.
    printed
        What is wrong, missing or contradictory there.
    read
        How it is read in the recommended sequence.
    basis
        ``"verified"``, ``"deduced"`` or ``"judgement"``.
    """

    code: str
    ref: str
    printed: str
    read: str
    basis: str


@cache
def errata() -> Mapping[str, Erratum]:
    """Return the errata of the published sequence by code."""
    return {code: Erratum(code, **entry) for code, entry in _data("errata").items() if code != "schema"}


def published_sequence(name: str = "vhp-female", *, as_printed: bool = False) -> Sequence:
    """Return a published sequence.

    The tables have no values between whole steps: there the recommended sequence follows the monotone curve through
    them, and where a polynomial is recommended that polynomial, refitted through rest if it misses it.

    Parameters
    ----------
    name
        One of `NAMES`.
    as_printed
        Whether the printed polynomials and expressions are taken with all their faults, else the recommended
        readings.

    Returns
    -------
    Sequence
        In the coordinates of the VHP-Female v.3.1 BASE model. Every parameter and motion names its errata. Cartilage
        and stomach have no motion: there are no usable numbers (E03, E52 to E57).

    Raises
    ------
    UsageError
        If there is no sequence of this name.
    """
    if name not in NAMES:
        raise UsageError(f"there is no published sequence {name!r}", hint=f"known: {', '.join(NAMES)}")
    data = _data()
    steps = int(data["sweep"]["N"])
    motions = [_tissue_motion(tissue, steps, as_printed) for tissue in data["tissue"]]
    for pair in data["ribs"]["pair"]:
        motions += [_rib_motion(pair, side, data["ribs"], steps, as_printed) for side in ("left", "right")]
    motions += _shell_motions(data["shell"], steps, as_printed)
    limits = data["limits"]
    return Sequence(
        name=f"{name}-as-printed" if as_printed else name,
        motions=tuple(motion for motion in motions if motion.operations or motion.fields),
        steps=steps,
        period_s=PERIOD_S,
        targets=Targets(limits["lung_volume_change_L"], float(limits["diaphragm_travel_mm"])),
        identity_at_rest=not as_printed,
        description=(
            "VHP-Female, the polynomials and expressions as printed, faults included"
            if as_printed
            else "VHP-Female, the recommended readings of the published tables and polynomials"
        ),
        source=_SOURCE,
        errata=_joined(
            data["sweep"]["errata"], data["affected"]["errata"], limits["errata"], data["cartilage"]["errata"]
        ),
    )


@cache
def _data(part: str = "") -> dict[str, Any]:
    name = f"vhp_female_{part}.toml" if part else "vhp_female.toml"
    return tomllib.loads((Path(__file__).parents[2] / "data" / name).read_text(encoding="utf-8"))


def _tissue_motion(tissue: Mapping[str, Any], steps: int, as_printed: bool) -> Motion:
    origin = triple(tissue["cs"]["origin"]) if "cs" in tissue else (0.0, 0.0, 0.0)
    found: dict[str, dict[str, Parameter]] = {}
    for transform in tissue.get("transform", ()):
        parameter = _printed(transform, steps) if as_printed else _recommended(tissue["name"], transform, steps)
        if parameter is not None:
            found.setdefault(transform["op"], {})[transform["axis"]] = parameter
    operations: list[Operation] = []
    for kind in _ORDER:
        for axis, angle in found.get(kind, {}).items() if kind == "rotate" else ():
            turned = not as_printed and "E71" in angle.errata
            operations.append(Rotate(_upside_down(origin) if turned else LocalFrame(origin), axis, angle))  # type: ignore[arg-type]
        if kind != "rotate" and kind in found:
            operations.append((Scale if kind == "scale" else Move)(LocalFrame(origin), **found[kind]))
    role, word = _ROLES.get(tissue["role"], (tissue["role"], ""))
    side = tissue.get("side", "")
    return Motion(
        name=tissue["name"],
        operations=tuple(operations),
        role=role,
        side="" if side == "both" else side,
        name_has=word,
        errata=_joined(tissue.get("errata", ()), tissue.get("cs", {}).get("errata", ())),
    )


def _printed(transform: Mapping[str, Any], steps: int) -> Parameter:
    """Return a parameter as the thesis' own parametric sweep has it: its polynomial, else its expression."""
    curve: Curve
    if "poly" in transform:
        curve = _in_mm(transform)
    elif transform["op"] == "scale":
        # (1 + q/N)^t
        growth = {"z": 0.1, "x": 0.01, "y": 0.01}[transform["axis"]]
        curve = Power(1.0 + growth / steps)
    else:
        curve = Polynomial((0.0, -3.0 / steps))
    return Parameter(curve, errata=tuple(transform["errata"]))


def _recommended(name: str, transform: Mapping[str, Any], steps: int) -> Parameter | None:
    """Return a parameter as recommended, None where it is to be fitted to a model."""
    codes = tuple(transform["errata"])
    identity = 1.0 if transform["op"] == "scale" else 0.0
    how = transform["recommended"]
    if name == "Lungs" and transform["op"] == "scale":
        full = _data("readings")["lungs"][f"scale_{transform['axis']}"]
        return Parameter(Polynomial((1.0, (full - 1.0) / steps)), errata=codes)
    if how == "expr":
        return _printed(transform, steps)
    if how == "poly":
        return _through_rest(_in_mm(transform), identity, steps, codes)
    if how == "table":
        reading = _data("readings").get(_READINGS.get(name, ""), {}).get(f"{transform['op']}_{transform['axis']}")
        values = reading["values"][1:] if reading else [identity + value for value in transform["table"]]
        return _through_table(values, identity, codes)
    return None


def _rib_motion(pair: Mapping[str, Any], side: str, ribs: Mapping[str, Any], steps: int, as_printed: bool) -> Motion:
    heads = {key: np.asarray(pair[f"control_{key}"]) for key in ("left", "right")}
    head = triple(heads[side])
    codes = tuple(pair["errata"])
    angles = {}
    for angle in ("theta", "phi"):
        if as_printed:
            angles[angle] = Parameter(Polynomial(tuple(map(float, pair[f"{angle}_poly"]))), errata=codes)
        elif pair["recommended"] == "poly":
            angles[angle] = _through_rest(Polynomial(tuple(map(float, pair[f"{angle}_poly"]))), 0.0, steps, codes)
        else:
            unit = _data("readings")["unit_steps"][f"rib_{pair['n']}"]
            angles[angle] = _through_table([k * unit[f"{angle}_deg"] for k in unit["k"]], 0.0, codes)
    # Outward is a turn about +z on the left and about -z on the right (E31).
    outward = LocalFrame(head) if side == "left" else _upside_down(head)
    return Motion(
        name=f"Rib {pair['n']} {side}",
        operations=(
            Rotate(LocalFrame.along(head, heads["right"] - heads["left"]), "x", angles["theta"]),
            Rotate(outward, "z", angles["phi"]),
        ),
        role="rib",
        side=side,
        number=int(pair["n"]),
        errata=_joined(ribs["errata"], codes),
    )


def _shell_motions(shell: Mapping[str, Any], steps: int, as_printed: bool) -> list[Motion]:
    amplitude = Parameter(Polynomial((0.0, shell["amplitude_mm"] / steps)), errata=tuple(shell["errata"]))
    if as_printed:
        region = shell["chest_region_printed"]
        taper = 0.0
    else:
        region, taper = _data("readings")["shells"], _data("readings")["shells"]["taper_mm"]
    field = Field(
        name="chest",
        amplitude=amplitude,
        x_window=tuple(region["x_mm"]),
        z_window=tuple(region["z_mm"]),
        y_back=region["y_mm_below"],
        x_taper=taper,
        y_taper=taper,
    )
    names = _SHELLS[:1] if as_printed else _SHELLS
    return [Motion(name=name, fields=(field,), role=role, errata=tuple(shell["errata"])) for name, role in names]


def _in_mm(transform: Mapping[str, Any]) -> Polynomial:
    """Return the printed polynomial; those of the abdominal muscles are in metres with a factor of 10^-3 (E05)."""
    to_mm = 1000.0 * transform["poly_factor"] if transform.get("poly_unit") == "m" else 1.0
    return Polynomial(tuple(float(value) * to_mm for value in transform["poly"]))


def _through_rest(curve: Polynomial, identity: float, steps: int, codes: tuple[str, ...]) -> Parameter:
    """Return a printed polynomial, or that nearest to it at t = 1..N which has the identity at t = 0."""
    if curve.coefficients[0] == identity:
        return Parameter(curve, errata=codes)
    times = np.arange(1.0, steps + 1.0)
    values = curve(times)
    pinned = fit_pinned(times, values, identity)
    return Parameter(pinned, tuple(values.tolist()), residual(pinned, times, values), codes)


def _through_table(values: list[float], identity: float, codes: tuple[str, ...]) -> Parameter:
    return Parameter(Interpolant((identity, *map(float, values))), errata=codes)


def _upside_down(origin: Triple) -> LocalFrame:
    """Return the coordinate system at `origin` that is turned about x by half a turn: its z points down."""
    return LocalFrame(origin, (1.0, 0.0, 0.0), (0.0, -1.0, 0.0))


def _joined(*groups: Iterable[str]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(code for group in groups for code in group))
