"""Modules that come with the extra "video", loaded when first used."""

from __future__ import annotations

from importlib import import_module
from types import ModuleType

VIDEO = ("pyvista", "vtk", "imageio[ffmpeg]", "matplotlib", "moviepy")
"""Packages of that extra. This package is on no index, so that its extra can be named in a clone only."""


def extra(name: str) -> ModuleType:
    """Import a module; an ImportError says what to install."""
    try:
        return import_module(name)
    except ImportError as error:
        # Double quotes are what every shell takes.
        packages = " ".join(f'"{package}"' if "[" in package else package for package in VIDEO)
        raise ImportError(f"pictures and videos need {error.name}: pip install {packages}") from error
