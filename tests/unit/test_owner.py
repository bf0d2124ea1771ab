"""The library in several threads, in processes of their own: the thread that first uses OpenGL decides for all."""

import subprocess
import sys

import pytest

pytestmark = pytest.mark.slow

BEFORE = """
from concurrent.futures import ThreadPoolExecutor

import torch

import scene_attack as sa
from scene_attack.targets.info import TARGETS

SPHERE = sa.Scene(camera=sa.Camera(size=(32, 32)), objects=[sa.Object(mesh="primitive/sphere")])

def target(seed):
    layer = torch.nn.Linear(192, 3)
    with torch.no_grad():
        layer.weight.copy_(torch.randn(3, 192, generator=torch.Generator().manual_seed(seed)))
    named = {"preprocessing": sa.Preprocessing(input_size=(8, 8)), "name": f"linear-{seed % 2}"}
    return sa.target(torch.nn.Sequential(torch.nn.Flatten(), layer), **named)
"""


def printed(code: str) -> str:
    command = [sys.executable, "-P", "-c", BEFORE + code]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_eight_attacks_in_eight_threads_give_the_results_of_eight_in_a_row() -> None:
    """The targets' names are taken in turn, two by two; OpenGL draws in each."""
    code = """
def attack(k):
    way = sa.ZOO(renderer="pyrender", steps=2, queries=20) if k % 2 else sa.FGSM(renderer="torch", steps=4)
    return sa.attack(SPHERE, target(k), way, seed=k).files

def kept(files):
    return {name: data for name, data in files.items() if not name.endswith(".json")}

with ThreadPoolExecutor(8) as pool:
    at_once = list(pool.map(attack, range(8)))
in_a_row = [attack(k) for k in range(8)]
print([kept(one) == kept(other) for one, other in zip(at_once, in_a_row)].count(True))
print([name for name in TARGETS if name.startswith("linear")])
"""
    assert printed(code) == "8\n[]\n"


def test_a_renderer_draws_for_every_thread() -> None:
    code = """
renderer = sa.renderer(SPHERE, "pyrender")
drawn = renderer.render({})
with ThreadPoolExecutor(3) as pool:
    images = list(pool.map(lambda _: renderer.render({}), range(6)))
print(all(torch.equal(image, drawn) for image in images))

lit = sa.renderer(SPHERE, "torch", groups=["illumination"])
light = {"illumination": lit.initial()["illumination"][None].requires_grad_()}
with torch.no_grad():
    print(lit.render(light).requires_grad)
print(lit.render(light).requires_grad)
"""
    assert printed(code).split() == ["True", "False", "True"]


def test_an_interrupted_attack_ends_and_the_next_one_runs() -> None:
    code = """
import os, signal

signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell may have started this test with SIGINT ignored

def stop(progress):
    if progress.row is not None:
        os.kill(os.getpid(), signal.SIGINT)

endless = sa.FGSM(renderer="image", steps=10_000, learning_rate={"image": 1e-9})
try:
    sa.attack(SPHERE, target(0), endless, progress=stop)
except KeyboardInterrupt:
    print("interrupted")
print(len(sa.attack(SPHERE, target(0), sa.FGSM(renderer="image", steps=1)).trace) > 0)
"""
    assert printed(code).split() == ["interrupted", "True"]


def test_a_process_that_was_forked_afterwards_says_what_would_be_right() -> None:
    code = """
import multiprocessing

def ask(answers):
    try:
        answers.put(renderer.render({}))
    except sa.JobFailure as error:
        answers.put(str(error))

renderer = sa.renderer(SPHERE, "pyrender")
fork = multiprocessing.get_context("fork")
answers = fork.Queue()
process = fork.Process(target=ask, args=(answers,), daemon=True)
process.start()
try:
    print(answers.get(timeout=120))
finally:
    process.kill()
"""
    assert printed(code).endswith("start it by multiprocessing's method spawn instead\n")


def test_a_loop_of_ones_own_has_gradients_of_poses() -> None:
    """They are differences of images, which OpenGL draws in its own thread, whichever thread asks for them."""
    code = """
drawn_by = sa.renderer(SPHERE, groups=["translation"])
at = drawn_by.initial()["translation"][None].requires_grad_()
(slope,) = torch.autograd.grad(drawn_by.render({"translation": at})[..., 16:, :].sum(), at)
print(float(slope[0, 0, 0].abs()) > 1)
"""
    assert printed(code) == "True\n"
