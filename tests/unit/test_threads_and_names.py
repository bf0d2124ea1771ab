"""Attacks of several threads on networks of this process, which all are called "module" unless they are named.

The network of one thread is known under its name while it is attacked; what another thread asks for meanwhile must
neither take it for its own nor leave it behind. Each test is a process of its own, as in test_owner.
"""

import subprocess
import sys

import pytest

pytestmark = pytest.mark.slow

BEFORE = """
import threading
from typing import Any

import torch
from torch import nn

import scene_attack as sa

SCENE = {"objects": [{"mesh": "primitive/sphere", "material": "plastic"}], "camera": {"size": [32, 32]}}
ATTACK = {"renderer": "torch", "groups": ["normals"], "method": "fgsm", "steps": 1}
LABELS = ["a", "b", "c"]
LOOK = {"input_size": [32, 32]}
WAIT = 20.0
OTHER = "the other thread"


def network(seed: int, forward=lambda: None) -> nn.Module:
    torch.manual_seed(seed)

    class Small(nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.layers = nn.Sequential(nn.AdaptiveAvgPool2d(4), nn.Flatten(), nn.Linear(48, len(LABELS)))

        def forward(self, images):
            forward()
            return self.layers(images)

    return Small().eval()


class Gated:
    # A target that is itself, but tells its name to the other thread only once the gate is open.

    def __init__(self, target: Any, gate: threading.Event, told: threading.Event) -> None:
        self._target, self._gate, self._told = target, gate, told

    @property
    def name(self) -> str:
        if threading.current_thread().name == OTHER:
            self._gate.wait(WAIT)
            self._told.set()
        return self._target.name

    def __getattr__(self, name: str) -> Any:
        return getattr(self._target, name)


def in_the_other_thread(work) -> tuple[threading.Thread, list[Any]]:
    answers: list[Any] = []

    def kept() -> None:
        try:
            answers.append(work())
        except Exception as error:
            answers.append(error)

    thread = threading.Thread(target=kept, name=OTHER)
    thread.start()
    return thread, answers
"""


def printed(code: str) -> str:
    command = [sys.executable, "-P", "-c", BEFORE + code]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_a_target_that_another_thread_attacks_now_is_attacked_afterwards() -> None:
    code = """
attacked, told = threading.Event(), threading.Event()
shared = Gated(sa.target(network(0), labels=LABELS, preprocessing=LOOK), attacked, told)

def running(_: Any) -> None:  # the target is known by its name
    attacked.set()
    told.wait(WAIT)
    threading.Event().wait(0.3)  # until the other thread has looked whether it is known

sa.attack(SCENE, shared, ATTACK)  # what is set up once is
thread, answers = in_the_other_thread(lambda: sa.attack(SCENE, shared, ATTACK))
threading.Event().wait(0.3)  # until it asks for the name
first = sa.attack(SCENE, shared, ATTACK, progress=running)
thread.join(WAIT)
(second,) = answers
print(second.attacked.answer == first.attacked.answer if isinstance(second, sa.Result) else second)
"""
    assert printed(code) == "True\n"


def test_the_network_of_another_thread_is_not_attacked_in_place_of_ones_own() -> None:
    code = """
attacked, looks, ended = threading.Event(), threading.Event(), threading.Event()

def forward() -> None:
    if threading.current_thread().name == OTHER:  # it tries a network that is not its own
        looks.set()
        ended.wait(WAIT)
    elif not attacked.is_set():
        attacked.set()
        looks.wait(1.0)

other = network(2)
theirs = sa.target(network(1, forward), labels=LABELS, preprocessing=LOOK)
own = Gated(sa.target(other, labels=LABELS, preprocessing=LOOK), attacked, threading.Event())
alone = sa.attack(SCENE, sa.target(other, labels=LABELS, preprocessing=LOOK), ATTACK)
thread, answers = in_the_other_thread(lambda: sa.attack(SCENE, own, ATTACK))
threading.Event().wait(0.3)  # until it asks for the name
sa.attack(SCENE, theirs, ATTACK)
ended.set()
thread.join(WAIT)
(result,) = answers
print(result.record.provenance.weights_sha256 == alone.record.provenance.weights_sha256)
print(result.original.answer == alone.original.answer)
"""
    assert printed(code) == "True\nTrue\n"
