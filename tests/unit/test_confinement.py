"""A confined process computes and writes to what is open, and can do nothing else."""

import json
import os
import platform
import subprocess
import sys

import pytest

from scene_attack.confinement import ALLOWED, program

pytestmark = pytest.mark.slow

SCRIPT = """
import ctypes, json, os, resource, signal, socket, subprocess, sys
from scene_attack.confinement import Limits, address_space, confine, drop_privileges
parent, secret = os.getppid(), sys.argv[1]
libc = ctypes.CDLL(None, use_errno=True)
def call(number, *given):
    if libc.syscall(number, *given) < 0:
        raise OSError(ctypes.get_errno(), "")
def run():
    pid = os.posix_spawn("/bin/true", ["true"], {})
def fork():
    if os.fork() == 0:
        os._exit(0)
tries = {
    "reads": lambda: open(secret).close(),
    "writes": lambda: open("/tmp/left-by-a-test", "w").close(),
    "lists": lambda: os.listdir("/"),
    "removes": lambda: os.unlink(secret),
    "connects": lambda: socket.socket().connect(("127.0.0.1", 9)),
    "unix socket": lambda: socket.socket(socket.AF_UNIX),
    "runs a program": run,
    "becomes a program": lambda: os.execve("/bin/true", ["true"], {}),
    "forks": fork,
    "signals": lambda: os.kill(parent, 0),
    "traces": lambda: call(TRACE, 16, parent, 0, 0),
    "raises its limits": lambda: resource.setrlimit(resource.RLIMIT_CPU, (10**6, 10**6)),
    "becomes root": lambda: os.setuid(0),
    "maps memory": lambda: bytearray(2**20),
    "maps too much memory": lambda: bytearray(2**28),
}
def outcome(attempt):
    try:
        attempt()
    except (OSError, MemoryError, ValueError) as error:
        return type(error).__name__
    return "done"
base = address_space()
missing = STEPS
said = {name: outcome(attempt) for name, attempt in tries.items()}
os.write(1, json.dumps({"missing": missing, "said": said, "environment": dict(os.environ)}).encode())
os._exit(0)
"""
TRACE = {"x86_64": 101, "aarch64": 117}.get(platform.machine(), -1)
STEPS = {
    "server": "drop_privileges()",
    "child": "drop_privileges() + confine(Limits(2**27, 5), base)",
}


def confined(tmp_path, steps):
    secret = tmp_path / "secret"
    secret.write_text("x")
    secret.chmod(0o666)
    script = SCRIPT.replace("STEPS", STEPS[steps]).replace("TRACE", str(TRACE))
    done = subprocess.run(
        [sys.executable, "-c", script, str(secret)], stdout=subprocess.PIPE, check=True, env=os.environ | {"KEY": "x"}
    )
    found = json.loads(done.stdout)
    assert found["missing"] == []
    assert found["environment"] == {}
    assert secret.exists()
    return found["said"]


def test_a_child_can_only_compute(tmp_path):
    said = confined(tmp_path, "child")
    assert said.pop("maps memory") == "done"
    assert said.pop("maps too much memory") == "MemoryError"
    assert set(said.values()) <= {"OSError", "PermissionError", "ValueError"}, said


def test_the_server_of_children_reaches_no_file(tmp_path):
    said = confined(tmp_path, "server")
    for name in ("reads", "writes", "lists", "removes", "runs a program", "becomes a program", "connects"):
        assert said[name] == "PermissionError", name
    assert said["forks"] == "done"


def test_a_processor_without_a_list_of_system_calls_is_refused():
    with pytest.raises(OSError, match="riscv64"):
        program("riscv64")


@pytest.mark.parametrize("machine", ["x86_64", "aarch64"])
def test_the_filter_ends_in_a_refusal(machine):
    code = program(machine)
    assert len(code) == 8 * (6 + len(ALLOWED))
    assert len({one[0] for one in ALLOWED.values()}) == len({one[1] for one in ALLOWED.values()})
