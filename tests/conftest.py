"""What several test modules share."""

import os

# without compiled imports every process that a test starts takes some 6 s more
os.environ["PYTHONDONTWRITEBYTECODE"] = ""
os.environ.setdefault("MPLBACKEND", "agg")
os.environ.setdefault("MMQA_HEADLESS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # threads would wait for each other

import ipaddress
import socket

import numpy as np
import pytest

from mmqa_lab import samples


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    """Let processes share the tests file by file, and the notebooks one by one."""
    from xdist.scheduler import LoadScopeScheduling

    class ByFile(LoadScopeScheduling):
        def _split_scope(self, nodeid):
            return nodeid if "test_notebook_runs" in nodeid else nodeid.split("::")[0]

    return ByFile(config, log)


@pytest.fixture(scope="session", autouse=True)
def no_network():
    """Refuse connections beyond this machine: everything works without a network."""
    connect = socket.socket.connect

    def connect_here(self, address):
        here = self.family == socket.AF_UNIX or address[0] == "localhost"
        if not here and not ipaddress.ip_address(address[0].split("%")[0]).is_loopback:
            raise OSError(f"Invalid address {address}. Must be on this machine.")
        return connect(self, address)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(socket.socket, "connect", connect_here)
        yield


@pytest.fixture
def real():
    """Path of a real cloud under MMQA_DATA by its relative name; skips where it is not there."""

    def find(relative):
        if not samples.has_real(relative):
            pytest.skip(f"needs {relative} in the folder that MMQA_DATA names")
        return samples.real_path(relative)

    return find


@pytest.fixture
def rng():
    """A seeded random generator."""
    return np.random.default_rng(20210112)
