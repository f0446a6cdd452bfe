"""What is to be exported, and what is known of each tissue of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from vhp_cli.config import Settings
from vhp_cli.measures import ExportTissue, Report
from vhp_cli.stages.export.materials import UserMaterial, own_volumes, properties_of

_KG_PER_MM3 = 1e-9  # of 1 kg/m3


@dataclass(frozen=True, slots=True)
class Job:
    """What is to be exported.

    Parameters
    ----------
    target
        Key of `vhp_cli.stages.export.targets.TARGETS`.
    forms
        Keys of `vhp_cli.formats.surfaces.FORMS`.
    unit
        Of the files, key of `vhp_cli.config.UNITS`.
    force
        Whether a model that fails the gate is exported all the same.
    frequency_hz
        Of permittivity and conductivity; None: only those that the user gives.
    materials
        What the user says of materials.
    """

    target: str
    forms: tuple[str, ...]
    unit: str = "mm"
    force: bool = False
    frequency_hz: float | None = None
    materials: tuple[UserMaterial, ...] = ()

    def as_dict(self) -> dict[str, object]:
        """Return everything, as the report stores it."""
        keys = ("match", "material", "permittivity", "conductivity", "density", "source")
        rows = [{key: value for key in keys if (value := getattr(row, key)) is not None} for row in self.materials]
        return {
            "for": self.target,
            "format": list(self.forms),
            "out-units": self.unit,
            "force": self.force,
            "frequency": self.frequency_hz,
            "materials": rows,
        }


def tissue_rows(
    report: Report,
    settings: Settings,
    job: Job,
    *,
    sources: Report | None = None,
    objects: Mapping[str, str] | None = None,
    rounding: Mapping[str, float] | None = None,
) -> list[ExportTissue]:
    """Return what is known of each tissue: what it is called, its material, its mass.

    Parameters
    ----------
    report
        A check of the model, for volumes and nesting.
    settings, job
        For the materials.
    sources
        The check of the files that were exported; None: `report`.
    objects, rounding
        By name of the tissue: of the object, and by how far (mm) coordinates were rounded.
    """
    volumes = {item["name"]: abs(item["volume_mm3"]) for item in report["tissues"] if item["closed"]}
    own = own_volumes(volumes, report["nesting"])
    source_of = {record["name"]: record for record in (sources or report)["tissues"]}
    names = [record["name"] for record in report["tissues"]]
    found: list[ExportTissue] = []
    for record, item in zip(
        report["tissues"], properties_of(names, settings, job.materials, job.frequency_hz), strict=True
    ):
        name = record["name"]
        volume = own.get(name)
        found.append(
            {
                "name": name,
                "object": (objects or {}).get(name, ""),
                "source": source_of[name]["file"],
                "source_sha256": source_of[name]["sha256"],
                "triangles": record["triangles"],
                "vertices": record["vertices"],
                "inside": report["nesting"].get(name),
                "rounding_mm": (rounding or {}).get(name),
                "own_volume_mm3": volume,
                "mass_kg": None if volume is None or item.density is None else volume * item.density * _KG_PER_MM3,
                "material": item.material,
                "permittivity": item.permittivity,
                "conductivity": item.conductivity,
                "density": item.density,
                "dielectric_source": item.dielectric_source,
                "density_source": item.density_source,
            }
        )
    return found
