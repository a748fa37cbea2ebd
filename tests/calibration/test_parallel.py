"""The adjustment spread over devices and processes: the optimum of one device, and a share of its memory."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

WORKER = Path(__file__).with_name("parallel_worker.py")


def run(*jobs):
    """Start one worker for every list of arguments, and return what each prints."""
    processes = [
        subprocess.Popen([sys.executable, str(WORKER), *map(str, job)], stdout=subprocess.PIPE, text=True)
        for job in jobs
    ]
    try:
        return [json.loads(process.communicate(timeout=300)[0].splitlines()[-1]) for process in processes]
    finally:
        for process in processes:
            process.kill()


@pytest.fixture(scope="module")
def alone():
    return run((1, 0, 1, 0))[0]


def same(found, alone):
    assert found["settled"]
    assert found["cost"] == pytest.approx(alone["cost"], rel=1e-9)
    np.testing.assert_allclose(found["positions"], alone["positions"], atol=1e-7)
    np.testing.assert_allclose(found["focals"], alone["focals"], rtol=1e-9)


def test_four_devices_reach_the_optimum_of_one(alone):
    four = run((4, 0, 1, 0))[0]
    same(four, alone)
    assert max(four["bytes"]) <= alone["bytes"][0] / 4


def test_two_processes_reach_the_optimum_of_one(alone, unused_port):
    both = run((1, 0, 2, unused_port), (1, 1, 2, unused_port))
    for found in both:
        same(found, alone)
        assert found["bytes"][0] <= alone["bytes"][0] / 2
    points = np.concatenate([found["points"] for found in both])
    np.testing.assert_allclose(points, alone["points"], atol=1e-6)


@pytest.fixture
def unused_port():
    import socket

    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return free.getsockname()[1]
