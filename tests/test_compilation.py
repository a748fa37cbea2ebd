"""Our `jit` beside `jax.jit`."""

import jax
import jax.numpy as jnp
import pytest

from jaxpoint.compilation import jit, jit_once


@pytest.mark.parametrize("ours", [jit, jit_once])
def test_it_works_alone_and_inside_other_transformations(ours):
    @ours
    def square(x):
        """The square."""
        return x * x

    assert square(3.0) == 9.0
    assert jax.jit(square)(3.0) == 9.0
    assert jax.jit(lambda x: x + square(2.0))(1.0) == 5.0  # no traced argument
    assert jax.grad(square)(3.0) == 6.0
    assert jax.vmap(square)(jnp.arange(3.0))[2] == 4.0
    assert square.__doc__ == "The square."


def test_other_errors_pass():
    @jit
    def fails(x):
        raise ValueError("mine")

    with pytest.raises(ValueError, match="mine"):
        fails(1.0)
