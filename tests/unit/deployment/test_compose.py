"""docker-compose.yml and the Dockerfile against the code they run; no container engine is needed."""

import re
from pathlib import Path
from typing import Any

import pytest
import yaml
from typer.testing import CliRunner

from scene_attack.addresses import is_loopback
from scene_attack.cli.app import app
from scene_attack_api.middleware import FORM_BYTES
from scene_attack_api.routes import service as health
from scene_attack_service.settings import DEFAULTS, Settings

ROOT = Path(__file__).parents[3]
COMPOSE: dict[str, Any] = yaml.safe_load((ROOT / "docker-compose.yml").read_text())
NGINX = (ROOT / "deploy/nginx.conf").read_text()
DOCKERFILE = (ROOT / "Dockerfile").read_text()
BUILD, PRODUCTION = re.split(r"^FROM .* AS production$", DOCKERFILE, flags=re.MULTILINE)
OURS = {name: service for name, service in COMPOSE["services"].items() if service.get("image") == "scene-attack"}


def test_there_are_a_proxy_an_api_a_redis_and_several_workers() -> None:
    assert set(COMPOSE["services"]) == {"redis", "api", "proxy", "worker"}
    assert set(OURS) == {"api", "worker"}
    assert COMPOSE["services"]["worker"]["deploy"]["replicas"] >= 2


@pytest.mark.parametrize("name", OURS)
def test_commands_are_commands_of_the_command_line(name: str) -> None:
    program, *arguments = OURS[name]["command"]
    assert program == "scene-attack"
    # Parsed in full; --help then keeps it from running.
    done = CliRunner().invoke(app, [*arguments, "--help"])
    assert done.exit_code == 0, done.output


@pytest.mark.parametrize("name", OURS)
def test_environment_variables_are_settings(name: str) -> None:
    known = {f"SCENE_ATTACK_{field.upper()}" for field in Settings.model_fields}
    assert set(OURS[name]["environment"]) - {"FORWARDED_ALLOW_IPS"} <= known  # the server's own
    assert set(re.findall(r"SCENE_ATTACK_\w+", DOCKERFILE)) <= known


def test_health_checks_ask_what_the_api_answers() -> None:
    paths = {getattr(route, "path", None) for route in health.router.routes}
    for service in OURS.values():
        (asked,) = re.findall(r"http://[\w.]+:(\d+)(/\w+)", service["healthcheck"]["test"][-1])
        assert asked[1] in paths
        assert asked[0] == "8008"


def test_the_api_answers_for_the_names_that_health_checks_use() -> None:
    environment = {name: value for name, value in OURS["api"]["environment"].items() if name == "SCENE_ATTACK_HOSTS"}
    known = Settings(hosts=environment.get("SCENE_ATTACK_HOSTS")).own_hosts
    for service in OURS.values():
        (host,) = re.findall(r"http://([\w.]+):", service["healthcheck"]["test"][-1])
        assert host in known or is_loopback(host)


def test_every_service_is_watched_and_keeps_its_hands_to_itself() -> None:
    for service in COMPOSE["services"].values():
        assert service["healthcheck"]["test"][0] == "CMD"
        assert service["read_only"] is True
        assert service["cap_drop"] == ["ALL"]


def test_the_service_is_reached_through_the_proxy_only_which_says_whose_a_request_is() -> None:
    assert [name for name, service in COMPOSE["services"].items() if "ports" in service] == ["proxy"]
    proxy = COMPOSE["services"]["proxy"]
    listens = re.findall(r"^ +listen (\d+);$", NGINX, re.MULTILINE)
    assert [f"127.0.0.1:8008:{port}" for port in listens] == proxy["ports"]
    assert f"http://127.0.0.1:{listens[0]}/" in proxy["healthcheck"]["test"][-1]
    assert proxy["volumes"] == [f"./deploy/nginx.conf:{proxy['command'][2]}:ro"]
    assert f"server api:{OURS['api']['command'][-1]};" in NGINX
    # A client's own word is replaced, not added to: the service lets loopback in while there is no key.
    assert "proxy_set_header X-Forwarded-For $remote_addr;" in NGINX
    assert OURS["api"]["environment"]["FORWARDED_ALLOW_IPS"] == "*"
    assert "FORWARDED_ALLOW_IPS" not in OURS["worker"]["environment"]


def test_the_proxy_takes_the_largest_upload() -> None:
    (megabytes,) = re.findall(r"client_max_body_size (\d+)m;", NGINX)
    assert int(megabytes) * 2**20 >= DEFAULTS.max_upload_bytes + FORM_BYTES


def test_redis_asks_for_a_password_that_no_command_line_shows() -> None:
    redis = COMPOSE["services"]["redis"]
    assert redis["environment"]["REDISCLI_AUTH"].startswith("${REDIS_PASSWORD:?")
    assert "requirepass" in redis["command"][-1]
    assert "REDIS_PASSWORD" not in str(redis["command"])
    for service in OURS.values():
        assert re.match(
            r"redis://:\$\{REDIS_PASSWORD:\?[^}]*\}@redis:", service["environment"]["SCENE_ATTACK_REDIS_URL"]
        )


def test_volumes_are_declared_and_are_where_the_image_keeps_things() -> None:
    kept = dict(volume.split(":") for volume in OURS["worker"]["volumes"])
    assert set(kept) == set(COMPOSE["volumes"])
    assert f"SCENE_ATTACK_DATA={kept['data']}" in PRODUCTION
    assert f"SCENE_ATTACK_CACHE={kept['cache']}" in PRODUCTION


def packages(stage: str) -> set[str]:
    """The Debian packages that a stage of the Dockerfile installs."""
    listed = re.search(r"apt-get install -y --no-install-recommends (.*) \\", stage)
    assert listed is not None
    return set(listed[1].split())


def test_the_build_has_what_setup_asks_for_and_is_not_run_by_root() -> None:
    asked = re.search(r"^packages=\((.*)\)$", (ROOT / "scripts/setup").read_text(), re.MULTILINE)
    assert asked is not None
    assert set(asked[1].split()) <= packages(BUILD)
    assert set(asked[1].split()) - packages(PRODUCTION) == {"g++"}
    assert PRODUCTION.rindex("\nUSER scene-attack") > PRODUCTION.rindex("\nRUN")


def test_the_production_image_has_no_compiler_and_no_test_tools() -> None:
    tools = re.compile(r"g\+\+|gcc|clang|build-essential|-dev$|python3-(venv|pip)|chromium|shellcheck")
    assert not [name for name in packages(PRODUCTION) if tools.search(name)]
    assert len(re.findall("^RUN ", PRODUCTION, re.MULTILINE)) == 2  # Debian's packages, and a user
    assert re.findall(r"^RUN scripts/setup(.*)$", BUILD, re.MULTILINE) == [""]  # not --test
    assert "pip" not in PRODUCTION
    assert "libgomp1" in packages(PRODUCTION)  # what g++ brought, and kernels are linked to


def test_the_image_has_the_wheel_with_its_kernels_and_neither_sources_nor_what_builds_it() -> None:
    ready = BUILD.index("RUN scripts/setup")  # a layer of its own, without the sources
    for root in ("services", "api", "worker"):
        assert ready < BUILD.index(f"COPY {root} {root}\n") < BUILD.index("pip wheel")
        assert f"COPY {root} " not in PRODUCTION
    assert BUILD.index("COPY requirements.txt requirements-torch.txt requirements-build.txt ./") < ready
    assert "pip install --no-deps --no-index /wheel/scene_attack-*-linux_*.whl" in BUILD  # not a pure one
    assert BUILD.index("pip wheel") < BUILD.index("pip uninstall --yes -r requirements-build.txt")


def test_what_the_image_copies_exists_and_is_not_ignored() -> None:
    allowed = [line[1:] for line in (ROOT / ".dockerignore").read_text().split() if line.startswith("!")]
    for line in re.findall(r"^COPY (?!--from)(.*)$", DOCKERFILE, re.MULTILINE):
        for source in line.split()[:-1]:
            assert (ROOT / source).exists(), source
            assert any(source == name or source.startswith(f"{name}/") for name in allowed), source
