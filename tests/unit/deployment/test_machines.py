"""docker-compose.machines.yml and the Kubernetes manifests against schemas and the code; no cluster is needed."""

import re
from pathlib import Path
from typing import Any

import kubernetes_validate
import pytest
import yaml
from typer.testing import CliRunner

from scene_attack.cli.app import app
from scene_attack_service.settings import Settings

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[3]
COMPOSE: dict[str, Any] = yaml.safe_load((ROOT / "docker-compose.machines.yml").read_text())
BASE: dict[str, Any] = yaml.safe_load((ROOT / "docker-compose.yml").read_text())
MANIFESTS = {
    f"{path.stem} {one['kind']}": one
    for path in sorted((ROOT / "deploy/kubernetes").glob("*.yaml"))
    for one in yaml.safe_load_all(path.read_text())
}
DEPLOYMENTS = {name: one for name, one in MANIFESTS.items() if one["kind"] == "Deployment"}
SETTINGS = {f"SCENE_ATTACK_{field.upper()}" for field in Settings.model_fields}


@pytest.mark.parametrize("manifest", MANIFESTS.values(), ids=MANIFESTS)
def test_each_manifest_is_valid_by_the_schema_of_its_kind(manifest: dict[str, Any]) -> None:
    kubernetes_validate.validate(manifest, "1.37", strict=True)


def test_a_manifest_that_is_wrong_is_not_valid() -> None:
    wrong = MANIFESTS["worker Deployment"] | {"spec": {"replicas": "four"}}
    with pytest.raises(kubernetes_validate.ValidationError):
        kubernetes_validate.validate(wrong, "1.37", strict=True)


@pytest.mark.parametrize("manifest", DEPLOYMENTS.values(), ids=DEPLOYMENTS)
def test_every_container_is_limited_and_keeps_its_hands_to_itself(manifest: dict[str, Any]) -> None:
    pod = manifest["spec"]["template"]["spec"]
    assert pod["securityContext"]["runAsNonRoot"] is True
    assert pod["automountServiceAccountToken"] is False
    assert pod["enableServiceLinks"] is False, "SCENE_ATTACK_PORT would be the address of the Service scene-attack"
    for container in [*pod["containers"], *pod.get("initContainers", ())]:
        own = container["securityContext"]
        assert own["readOnlyRootFilesystem"] is True
        assert own["allowPrivilegeEscalation"] is False
        assert own["capabilities"] == {"drop": ["ALL"]}
        assert "memory" in container["resources"]["limits"]


def variables(container: dict[str, Any]) -> set[str]:
    return {one["name"] for one in container.get("env", ())}


@pytest.mark.parametrize("name", ["api Deployment", "worker Deployment"])
def test_commands_and_variables_are_those_of_the_code(name: str) -> None:
    (container,) = MANIFESTS[name]["spec"]["template"]["spec"]["containers"]
    program, *arguments = container["args"]
    assert program == "scene-attack"
    assert CliRunner().invoke(app, [*arguments, "--help"]).exit_code == 0
    given = variables(container) | set(MANIFESTS["config ConfigMap"]["data"])
    assert {one for one in given if not one.startswith("AWS_")} <= SETTINGS
    assert {"SCENE_ATTACK_DATABASE_URL", "SCENE_ATTACK_REDIS_URL", "SCENE_ATTACK_ARTIFACT_URL"} <= given


def test_no_secret_is_in_a_manifest_and_each_is_named_in_the_configuration() -> None:
    text = "".join(path.read_text() for path in (ROOT / "deploy/kubernetes").glob("*.yaml"))
    assert all(one["kind"] != "Secret" for one in MANIFESTS.values())
    named = (ROOT / "deploy/kubernetes/config.yaml").read_text()
    for key in set(re.findall(r"secretKeyRef: \{name: scene-attack, key: ([\w-]+)\}", text)):
        assert key in named


def test_compose_adds_a_database_and_a_store_to_the_services_that_there_are() -> None:
    assert set(COMPOSE["services"]) - set(BASE["services"]) == {"postgresql", "store", "bucket"}
    for name in ("api", "worker"):
        given = COMPOSE["services"][name]["environment"]
        assert {one for one in given if not one.startswith("AWS_")} <= SETTINGS
        assert given["SCENE_ATTACK_DATABASE_URL"].startswith("postgresql://scene_attack:${POSTGRES_PASSWORD:?}@")
        assert set(COMPOSE["services"][name]["depends_on"]) <= set(COMPOSE["services"])
    for name in ("postgresql", "store", "bucket"):
        service = COMPOSE["services"][name]
        assert service["read_only"] is True
        assert service["cap_drop"] == ["ALL"]
        assert "ports" not in service, "it is reached from the other containers only"
