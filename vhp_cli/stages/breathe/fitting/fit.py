"""Find the motion of every tissue, in the order of thesis 3.5 to 3.8."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from vhp_cli.errors import UsageError
from vhp_cli.stages.breathe.fitting import cage, ribs, shells, soft
from vhp_cli.stages.breathe.fitting.candidates import choose
from vhp_cli.stages.breathe.fitting.cartilages import find_joined
from vhp_cli.stages.breathe.fitting.ends import rib_ends
from vhp_cli.stages.breathe.fitting.lungs import ACROSS, LungMotion, fit_lungs
from vhp_cli.stages.breathe.fitting.scene import Scene, Shortfall, by_part, near
from vhp_cli.stages.breathe.mass import MassModel
from vhp_cli.stages.breathe.nesting import ancestors
from vhp_cli.stages.breathe.profile import Profile
from vhp_cli.stages.breathe.roles import BONE, SHELLS
from vhp_cli.stages.breathe.sequence import STEPS, Motion, Targets
from vhp_cli.stages.breathe.sequence import Sequence as Breath
from vhp_cli.stages.breathe.tissue import Tissue, box

Progress = Callable[[str, int, int], None]

# Pushed by lungs and diaphragm, in the order in which they give way to each other.
ORGANS = ("heart", "liver", "stomach", "spleen", "kidney")
MUSCLES = ("pectoral", "abdominal", "erector")
# These stay as they are.
SPINE = ("vertebra", "disc")
FIXED = (BONE, *SPINE)

_QUIET = Targets()

_REACH_MM = 45.0
_BESIDE_MM = 12.0
# Shares of the usual forward motion that lungs may take where bones are in their way.
_FORWARD = (1.0, 0.75, 1.5, 0.5, 2.0, 0.25, 0.0)
_MOST_NEIGHBOURS = 4
_PASSES = 5
# Shares of the lungs' way forward that ribs may take part in.
_FOLLOWING = (1.0, 0.75, 0.5, 0.25, 0.0)
# How far below the lungs, and above the lower end of the shells, these begin to rise.
_BELLY_MM, _END_MM = 150.0, 20.0


@dataclass(frozen=True, slots=True)
class FitSettings:
    """What a breath is to achieve and to keep.

    Parameters
    ----------
    targets
        Of the lungs.
    steps
        N.
    gap_mm
        The gap to keep, or that at rest where it is smaller.
    forward_mm
        How far the lungs move forward; None: as in the thesis, or less where that has no room.
    period_s
        Duration of a breath.
    ribs
        ``"follow"``: the ribs lift so far that the front of the chest goes forward with the lungs, if all tissues have
        room for that, or less; ``"least"``: they make room for the lungs and no more.
    """

    targets: Targets = _QUIET
    steps: int = STEPS
    gap_mm: float = 1.0
    forward_mm: float | None = None
    period_s: float = 5.0
    ribs: Literal["follow", "least"] = "follow"


@dataclass(frozen=True, slots=True)
class Fit:
    """The motion that was found.

    Parameters
    ----------
    sequence
        The motion.
    lungs
        That of the lungs.
    angles
        Of each pair of ribs at t = N: lift and spread in degrees.
    shortfalls
        Where room is missing, the worst first.
    notes
        What the user should know.
    """

    sequence: Breath
    lungs: LungMotion
    angles: Mapping[int, tuple[float, float]]
    shortfalls: tuple[Shortfall, ...]
    notes: tuple[str, ...] = field(default=())


def fit(
    tissues: Sequence[Tissue],
    parents: Mapping[str, str | None],
    mass: MassModel | None,
    settings: FitSettings,
    progress: Progress | None = None,
) -> Fit:
    """Find the motion of every tissue of a model at rest.

    Parameters
    ----------
    tissues
        In the frame LPS, in mm.
    parents
        The smallest tissue around each tissue.
    mass
        To be held by the shells; None: these only make room.
    settings
        Targets and limits.

    Raises
    ------
    UsageError
        If the model has no lungs.
    """
    if not any(tissue.role.part == "lung" for tissue in tissues):
        raise UsageError(
            "the model has no lungs",
            hint='name a tissue "lung...", or say so in vhp.toml: [[tissue]] match = "..." breathe = { role = "lung" }',
        )
    return _Fitting(tissues, parents, mass, settings, progress).run()


class _Fitting:
    def __init__(
        self,
        tissues: Sequence[Tissue],
        parents: Mapping[str, str | None],
        mass: MassModel | None,
        settings: FitSettings,
        progress: Progress | None,
    ) -> None:
        self.scene = Scene(tissues, settings.gap_mm, settings.steps)
        self.settings = settings
        self.mass = mass
        self.parents = dict(parents)
        self.parts = by_part(self.scene.tissues)
        self.progress = progress
        self.notes: list[str] = []
        self.shells = [name for part in SHELLS for name in self.parts.get(part, ())]
        # What lies within a tissue that is no shell goes where that one goes.
        self.riders: dict[str, str] = {}
        for name in self.scene.tissues:
            around = next((a for a in ancestors(name, self.parents) if a not in self.shells), None)
            if around is not None and self.scene.tissues[name].role.part not in ("lung", *SHELLS):
                self.riders[name] = ancestors(name, self.parents)[0]
        self.lungs = self.parts["lung"]
        self.fixed = self.free(*FIXED)
        self.placed: list[str] = []

    def free(self, *parts: str) -> list[str]:
        """Return the tissues of some parts that do not lie within another."""
        return [name for part in parts for name in self.parts.get(part, ()) if name not in self.riders]

    def run(self) -> Fit:
        scene = self.scene
        ribs_by_place, cartilages = self._numbered("rib"), self._numbered("cartilage")
        spine = [scene.tissues[name] for name in self.fixed if scene.tissues[name].role.part == "vertebra"]
        ends = {name: rib_ends(scene.tissues[name], spine) for name in ribs_by_place.values()}
        pairs = ribs.make_pairs(ribs_by_place, ends, cartilages)
        lungs = fit_lungs(
            [scene.tissues[name] for name in self.lungs],
            self.settings.targets,
            self._midline(pairs, spine),
            self.settings.forward_mm,
        )
        if not ACROSS[0] <= lungs.across <= ACROSS[1]:
            self.notes.append(
                f"volume and travel hardly suit these lungs: they are scaled by {lungs.across:.4f} across and "
                f"{lungs.along:.4f} along"
            )
        lungs = self._clear_of_bones(lungs)
        if not pairs:
            self.notes.append("the model has no ribs: the lungs move alone")
        return self._best(lungs, pairs, self._cage(cartilages, ribs_by_place))

    def _cage(self, cartilages: Mapping[tuple[str, int], str], by_place: Mapping[tuple[str, int], str]) -> cage.Cage:
        scene, sternum = self.scene, self.free("sternum")
        struts = cage.make_struts(scene, cartilages, by_place, sternum)
        ends = {strut.name: (strut.rib, strut.holder) for strut in struts}
        joined = find_joined(scene, self.free("cartilage"), list(by_place.values()), sternum, ends)
        escorts = cage.find_escorts(scene, sternum, [name for name in self.fixed if name not in self.free(*SPINE)])
        return cage.Cage(tuple(sternum), tuple(escorts), tuple(struts), joined)

    def _best(self, lungs: LungMotion, pairs: Sequence[ribs.Pair], body: cage.Cage) -> Fit:
        """Let the ribs go forward with the lungs as far as that has room everywhere, else as little as they can."""
        shares = _FOLLOWING if self.settings.ribs == "follow" and pairs else (0.0,)
        best: Fit | None = None
        chosen = 0.0
        for number, share in enumerate(shares):
            self._step(f"attempt {number + 1}", number, len(shares))
            found = self._attempt(lungs, pairs, body, share, give_up=best is not None and share > 0.0)
            if found is not None and (best is None or _missing(found) < _missing(best)):
                best = found
                chosen = share
            if best is not None and not best.shortfalls:
                break
        assert best is not None
        if shares[0] and chosen < 1.0:
            note = f"the ribs follow the lungs' way forward by {chosen:.0%}: room, or contact at rest, allows no more"
            best = replace(best, notes=(*best.notes, note))
        return best

    def _attempt(
        self,
        lungs: LungMotion,
        pairs: Sequence[ribs.Pair],
        body: cage.Cage,
        share: float,
        *,
        give_up: bool,
    ) -> Fit | None:
        """Fit everything but the lungs; None if the ribs can't go so far, or the cage has no room and `give_up`."""
        scene = self.scene
        for name in list(scene.motions):
            if name not in self.lungs:
                scene.set(name, None)
        staying = [name for name in self.fixed if name not in body.tissues]
        angles = ribs.fit_ribs(scene, pairs, self.lungs, staying, self.free(*SPINE), share * lungs.forward_mm)
        if angles is None:
            return None
        own = [name for pair in pairs for name in pair.ribs.values()]
        cage.fit_cage(scene, body, [*self.lungs, *staying, *own])
        self.placed = list(dict.fromkeys([*self.lungs, *own, *body.tissues, *staying]))
        if give_up and self._shortfalls(self.placed):
            return None
        self._soft(self._profile(lungs))
        for name in self._outer_first(self.riders):
            scene.set(name, soft.riding(scene, name, self.riders[name]))
        self._shells(body.sternum)
        return self._result(lungs, angles)

    def _clear_of_bones(self, lungs: LungMotion) -> LungMotion:
        """Place the lungs, more or less far forward where that is needed to clear the bones that stay."""
        scene = self.scene
        choices = [1.0] if self.settings.forward_mm is not None else _FORWARD
        around = {name: near(scene, name, self.fixed, _REACH_MM) for name in self.lungs}
        best = lungs
        for share in choices:
            moved = replace(lungs, forward_mm=lungs.forward_mm * share)
            missing = sum(
                scene.badness(name, moved.motion(name, (name,), scene.steps), around[name], scene.times)
                for name in self.lungs
            )
            if missing == 0.0:
                best = moved
                break
        for name in self.lungs:
            scene.set(name, best.motion(name, tuple(self.lungs), scene.steps))
        return best

    def _step(self, what: str, done: int, total: int) -> None:
        if self.progress:
            self.progress(f"fit: {what}", done, total)

    def _numbered(self, part: str) -> dict[tuple[str, int], str]:
        found: dict[tuple[str, int], str] = {}
        for name in self.free(part):
            role = self.scene.tissues[name].role
            side = role.side or ("left" if self.scene.tissues[name].centre[0] > self._middle() else "right")
            if role.number is None or (side, role.number) in found:
                self.notes.append(f"{name}: no number of its own, so that it stays: {role}")
                self.fixed.append(name)
            else:
                found[side, role.number] = name
        return found

    def _middle(self) -> float:
        low, high = box([self.scene.tissues[name] for name in self.lungs])
        return float(0.5 * (low[0] + high[0]))

    def _midline(self, pairs: Sequence[ribs.Pair], spine: Sequence[Tissue]) -> float:
        """Return x of the plane between left and right: between the heads of ribs, else through the spine."""
        middles = [0.5 * float(p.ends["left"].head[0] + p.ends["right"].head[0]) for p in pairs if len(p.ribs) == 2]
        if middles:
            return float(np.mean(middles))
        if spine:
            return float(np.mean([bone.centre[0] for bone in spine]))
        return self._middle()

    def _profile(self, lungs: LungMotion) -> Profile:
        tissues = self.scene.tissues
        floor_parts = (*ORGANS, "diaphragm", "carried")
        low = [tissues[name].lower[2] for name in self.free(*floor_parts)]
        airy = [tissues[name].lower[2] for name in (*self.lungs, *self.free("diaphragm"))]
        return soft.descent(lungs, float(min(airy)), float(min([*low, *airy])), self.settings.steps)

    def _soft(self, profile: Profile) -> None:
        """Place organs, muscles and all else that is soft, and go over them again until nothing changes."""
        scene = self.scene
        organs = [name for part in ("diaphragm", *ORGANS) for name in self.free(part)]
        muscles = self.free(*MUSCLES)
        settled = {*self.placed, *self.shells}
        rest = sorted(
            (name for name in scene.tissues if name not in {*settled, *organs, *muscles, *self.riders}),
            key=lambda name: (-scene.tissues[name].volume_mm3, name),
        )
        order = [*organs, *muscles, *rest]
        times = scene.times
        for number in range(_PASSES):
            changed = False
            for name in order:
                known = [*self.placed, *(order if number else order[: order.index(name)])]
                obstacles = near(scene, name, known, _REACH_MM)
                before = scene.motions.get(name)
                if number and scene.badness(name, before, obstacles, times, contacts=True) == 0.0:
                    continue
                choose(scene, name, self._candidates(name, profile, obstacles), obstacles, times)
                changed = changed or scene.motions.get(name) != before
            if number and not changed:
                break

    def _candidates(self, name: str, profile: Profile, obstacles: Sequence[str]) -> list[Motion | None]:
        scene, part = self.scene, self.scene.tissues[name].role.part
        if part in ORGANS or part == "diaphragm":
            found = soft.organ_candidates(scene, name, profile)
            lungs = scene.motions[self.lungs[0]]
            return (
                [*found, Motion(name, lungs.operations, tissues=(name,), role=part)] if part == "diaphragm" else found
            )
        if part in MUSCLES:
            return soft.muscle_candidates(scene, name)
        beside = near(scene, name, obstacles, _BESIDE_MM)
        own = scene.tissues[name].centre
        beside.sort(key=lambda other: (float(np.linalg.norm(scene.tissues[other].centre - own)), other))
        return soft.carried_candidates(scene, name, profile, beside[:_MOST_NEIGHBOURS])

    def _shells(self, sternum: Sequence[str]) -> None:
        scene = self.scene
        if not self.shells or self.mass is None:
            return
        found = [scene.tissues[name] for name in self.shells]
        lungs = [scene.tissues[name] for name in self.lungs]
        top = box([scene.tissues[name] for name in sternum])[1][2] if sternum else box(lungs)[1][2]
        inner = min(found, key=lambda shell: shell.volume_mm3)
        bottom = max(float(box(lungs)[0][2]) - _BELLY_MM, float(inner.lower[2]) + _END_MM)
        shape = shells.shell_field(found, lungs, bottom, float(top), shells.NO_AMPLITUDE)
        shells.fit_shells(scene, found, shape, self.mass)

    def _outer_first(self, riders: Mapping[str, str]) -> list[str]:
        return sorted(riders, key=lambda name: len(ancestors(name, self.parents)))

    def _result(self, lungs: LungMotion, angles: Mapping[int, tuple[float, float]]) -> Fit:
        scene = self.scene
        motions = tuple(scene.motions[name] for name in scene.tissues if name in scene.motions)
        sequence = Breath("fitted", motions, self.settings.steps, self.settings.period_s, targets=self.settings.targets)
        notes = list(self.notes)
        if not self.shells:
            notes.append("the model has no skin, fat or body around the lungs: its mass is not held")
        return Fit(sequence, lungs, angles, tuple(self._shortfalls(list(scene.tissues))), tuple(notes))

    def _shortfalls(self, names: Sequence[str]) -> list[Shortfall]:
        """Return every lack of room among some tissues, the worst first."""
        scene = self.scene
        found: list[Shortfall] = []
        for index, name in enumerate(names):
            if name in scene.motions:
                others = [other for place, other in enumerate(names) if other not in scene.motions or place < index]
                found += scene.shortfalls(name, scene.motions[name], others, scene.times, all_of=True, contacts=True)
        return sorted(found, key=lambda item: (-item.missing_mm, item.tissue, item.other))


def _missing(found: Fit) -> float:
    return sum(item.missing_mm for item in found.shortfalls)
