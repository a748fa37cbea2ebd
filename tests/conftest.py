"""Shared by all tests: where the real recordings lie, and strict JAX settings."""

import os
from pathlib import Path

import jax
import pytest

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_rank_promotion", "raise")


@pytest.fixture(scope="session")
def data_folder() -> Path:
    """The folder of real recordings, named by the environment variable JAXPOINT_DATA."""
    value = os.environ.get("JAXPOINT_DATA")
    if not value:
        pytest.skip("JAXPOINT_DATA is not set: it names the folder of real recordings.")
    folder = Path(value)
    assert folder.is_dir(), f"JAXPOINT_DATA names {folder}, which is not a folder."
    return folder
