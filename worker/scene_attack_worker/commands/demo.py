"""`demo`: the service, attacking furniture and the answer to a question."""

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from time import sleep
from typing import TYPE_CHECKING, Annotated, Any

import typer

from scene_attack.cli.console import FittedTable, err, remark, say, state_text
from scene_attack.errors import JobFailure
from scene_attack.process import program
from scene_attack.targets.info import TARGETS

if TYPE_CHECKING:
    from scene_attack.client.client import Client
    from scene_attack.client.schemas import JobView


SCENES: dict[str, dict[str, Any]] = {
    "soccer ball": {"objects": [{"mesh": "furniture/soccer-ball"}]},
    "grand piano": {"objects": [{"mesh": "furniture/grand-piano", "material": "glossy-paint"}]},
    "power drill": {"objects": [{"mesh": "furniture/drill", "material": "plastic"}]},
}
"""The scenes by their true label, which is the network's answer to the original image.

The network is confident of two (log-probability margins of at least 4.7 in pyrender's image) and less so of the third
(2.5). Light, colour and pose rarely fool a confident network, and the demonstration should show both outcomes.
"""
ATTACKS: tuple[dict[str, Any], ...] = (
    {"renderer": "torch", "groups": ["bump", "dials", "lamp"], "method": "fgsm"},
    {"renderer": "torch", "groups": ["normals", "illumination", "material"], "method": "fgsm"},
    {"renderer": "pyrender", "method": "zoo", "steps": 60, "weight": 1e-3, "learning_rate": 5e-3},
)
"""The first changes what a thing and a room could have, the second is the paper's. ZOO has a λ a hundred times smaller
than the paper's 0.1, with which no physical attack fooled the network in our trials."""
QUESTION: dict[str, Any] = {
    "scene": {"source": {"format": "clevr", "generate": {"seed": 8, "objects": 4}}},
    "target": {
        "name": "iep",
        "ask": {"question": "What is the color of the object that is left of the cyan thing?"},
    },
    "attack": {"renderer": "torch", "groups": ["normals", "illumination"], "method": "fgsm", "steps": 40},
}
"""The request of `examples/vqa-torch.json`."""


def specs() -> list[dict[str, Any]]:
    """One request per scene and attack, and that of the question where the plug-in that asks it is installed."""
    furniture = [
        {"scene": scene, "goal": {"leave": label}, "attack": attack}
        for label, scene in SCENES.items()
        for attack in ATTACKS
    ]
    return [*furniture, QUESTION] if QUESTION["target"]["name"] in TARGETS else furniture


LOOK_EVERY = 0.5
"""Seconds between two looks at the jobs."""


app = typer.Typer()


@app.command(epilog="Example: [bold]scene-attack demo --once[/bold]")
def demo(
    once: Annotated[bool, typer.Option("--once", help="End when the jobs have ended.")] = False,
) -> None:
    """Start the service, attack furniture and the answer to a question through its HTTP API, and show the outcome.

    Three things the network gets right, each attacked by dents, dials of its material and the light of the room, by
    the paper's free normals, light and material, and by the physical parameters of the other renderer; and a question
    about a scene of solids. What fooled the network is said in words; an attack that did not is shown as held.

    The exit code is 0 if all jobs ran to their end.
    """
    from scene_attack.cli.tables import successes
    from scene_attack.client.client import Client
    from scene_attack.runs.environment import options_to_run
    from scene_attack_service.settings import read_settings

    values = read_settings()
    options_to_run()
    data = values.data_dir / "demo"
    remark("starting the service: networks and OpenGL are loaded once")
    with running_service(data, {"SCENE_ATTACK_PORT": str(_free_port(values.host, values.port))}) as (url, process):
        remark(f"service at {url}, its log in {data / 'service.log'}")
        with Client(url) as client:
            _clear(client)
            jobs = _watch(client, [client.submit(spec).id for spec in specs()])
        say(_table(jobs), successes(job.outcome for job in jobs if job.outcome is not None))
        for job in jobs:
            _say_finding(job)
        remark(*(f"{_name(job)} failed: {job.failure.detail}" for job in jobs if job.failure is not None))
        if once:
            say(f"Dashboard: SCENE_ATTACK_DATA={data} scene-attack serve")
        else:
            say(f"Dashboard: {url}")
            remark("It stays up; Ctrl-C ends it.")
            with suppress(KeyboardInterrupt):
                process.wait()
    if any(job.state != "succeeded" for job in jobs):
        raise typer.Exit(1)


def _clear(client: "Client") -> None:
    """Cancels what a demonstration that was broken off has left behind."""
    from scene_attack.client import operations

    for job in client.list_jobs(state=("queued", "running")):
        client.call(operations.cancel_job(job.id))


def _watch(client: "Client", ids: list[str]) -> list["JobView"]:
    """Shows the jobs until all have ended; returns them in the order of `ids`."""
    from rich.live import Live

    console, told = err(), dict.fromkeys(ids, "")
    with Live(console=console, auto_refresh=False, transient=True) as live:
        while True:
            jobs = [client.get_job(job_id).data for job_id in ids]
            if console.is_terminal:
                live.update(_table(jobs), refresh=True)
            else:
                for job in jobs:
                    if told[job.id] != job.state:
                        told[job.id] = job.state
                        remark(f"{_name(job)}: {job.state}")
            if all(job.state.terminal for job in jobs):
                return jobs
            sleep(LOOK_EVERY)


def _table(jobs: list["JobView"]) -> FittedTable:
    from scene_attack.cli.tables import COLUMNS, SPARE, cells

    rows = []
    for job in jobs:
        if job.outcome is not None:
            rows.append([*cells(job.name, job.attack, job.outcome)])
        else:
            state = state_text(job.state)
            if job.state == "running" and job.progress:
                state.append(f" {job.progress.step}/{job.progress.steps}")
            rows.append([job.name, job.attack, state, *[""] * (len(COLUMNS) - 3)])
    return FittedTable(COLUMNS, rows, spare=SPARE)


def _say_finding(job: "JobView") -> None:
    """Prints what fooled the network in words, if it was a change that a thing or a room could have."""
    from scene_attack.rendering.declaration import RENDERERS
    from scene_attack.runs.result import Result

    result = job.result
    if isinstance(result, Result) and result.verified:
        attack: Any = result.spec["attack"]
        if set(attack["groups"]) <= set(RENDERERS[attack["renderer"]].natural_groups):
            say(f"{_name(job)}: {result.original.label} → {result.attacked.label}")
            say(*result.findings)


def _name(job: "JobView") -> str:
    return f"{job.name}, {job.attack}"


def _free_port(host: str, port: int) -> int:
    """Returns `port` if it is free, else 0, which stands for any free port."""
    import socket

    try:
        socket.create_server((host, port)).close()
    except OSError:
        return 0
    return port


STOP_SECONDS = 30.0


@contextmanager
def running_service(data: Path, environ: dict[str, str]) -> Iterator[tuple[str, "subprocess.Popen[str]"]]:
    """Starts `scene-attack serve` with the data directory `data` and the environment variables `environ`.

    Gives its URL and its process once it takes jobs. Its log is `data`/service.log. The service is stopped on leaving,
    also by SIGTERM or SIGINT. Raises JobFailure("internal") if it ends before it is ready.
    """
    from scene_attack.confinement import die_with_parent

    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))
    # A shell without job control starts background processes with SIGINT ignored, and Python then leaves it ignored.
    # The service has to be stopped in order, so this process handles the signal, as `serve` does.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    for folder in (data.parent, data):  # of which others may read nothing
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    log = data / "service.log"
    with log.open("ab") as errors:
        process = subprocess.Popen(
            program("scene_attack", "serve"),
            env=os.environ | environ | {"SCENE_ATTACK_DATA": str(data)},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=errors,
            text=True,
            start_new_session=True,  # Ctrl-C then reaches this process alone, which stops the service
            preexec_fn=die_with_parent,  # safe: there is one thread; it ends the service if this process is killed
        )
    assert process.stdout is not None
    try:
        word, _, url = process.stdout.readline().strip().partition(" ")
        if word != "ready":
            raise JobFailure("internal", f"the service did not start; its log: {log}")
        yield url, process
    finally:
        process.send_signal(signal.SIGTERM)
        try:
            process.wait(STOP_SECONDS)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
        process.stdout.close()
