"""Our `jit` beside `jax.jit`, and programs kept for later."""

import subprocess
import sys

import jax
import jax.numpy as jnp
import pytest

from jaxpoint.compilation import jit, jit_once, keep_programs


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


def test_programs_are_kept_apart_by_version_and_processor(tmp_path, monkeypatch):
    script = (
        "import pathlib, sys, jax, jax.numpy as jnp; from jaxpoint.compilation import jit, keep_programs;"
        "print(keep_programs(pathlib.Path(sys.argv[1]))); jit(lambda x: jnp.sin(x) @ x)(jnp.ones(8))"
    )
    ran = subprocess.run([sys.executable, "-c", script, tmp_path], capture_output=True, text=True, check=True)
    (own,) = tmp_path.iterdir()
    assert ran.stdout.strip() == str(own)
    assert any(own.iterdir())
    monkeypatch.setattr("jaxpoint.compilation._processor", lambda: "another")
    monkeypatch.setattr(jax.config, "update", lambda name, value: None)
    assert keep_programs(tmp_path) != own


def test_options_of_a_cpu_go_to_a_cpu_alone(monkeypatch):
    """Shown by an option that XLA does not know."""
    strange = jit(lambda x: x + 1, options={"xla_cpu_of_another_world": True})
    with pytest.raises(jax.errors.JaxRuntimeError, match="xla_cpu_of_another_world"):
        strange(1.0)
    monkeypatch.setattr("jaxpoint.compilation.on_cpu", lambda *trees: False)
    assert strange(1.0) == 2.0
    assert jax.jit(strange)(1.0) == 2.0


def test_it_works_in_loops_and_where_shapes_alone_are_asked_for():
    @jit
    def double(x):
        return 2 * x

    assert jax.lax.scan(lambda x, _: (double(x), None), jnp.ones(()), length=3)[0] == 8.0
    assert jax.eval_shape(double, jnp.ones(3)).shape == (3,)
    assert jax.jvp(double, (1.0,), (1.0,))[1] == 2.0
