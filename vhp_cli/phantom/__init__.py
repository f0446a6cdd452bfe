"""A procedural torso: sound tissue surfaces for tests, demonstrations and benchmarks, and planted defects."""

from __future__ import annotations

from vhp_cli.phantom.model import generate

__all__ = ["generate"]
