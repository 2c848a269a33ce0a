"""Modules that come with the extra "video", loaded when first used."""

from __future__ import annotations

from importlib import import_module
from types import ModuleType


def extra(name: str) -> ModuleType:
    """Import a module; an ImportError says what to install."""
    try:
        return import_module(name)
    except ImportError as error:
        raise ImportError(f"pictures and videos need {error.name}: pip install lattice_gym[video]") from error
