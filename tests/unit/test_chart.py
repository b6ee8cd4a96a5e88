"""The chart for Kubernetes, rendered by Helm's own engine and held to Kubernetes' own schemas."""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlsplit

import helm_python
import kubernetes_validate
import pytest
import yaml

from api.routes.catalog import SlotFilters
from core.configuration import names
from core.devices import gpu_indices
from gaitway.schema import SlotsView

ROOT = Path(__file__).parents[2]
CHART = ROOT / "deploy/kubernetes/gaitway"
(LAB,) = re.findall(r"```yaml\n(.*?)```", (ROOT / "docs/clusters.md").read_text(), re.DOTALL)
KUBERNETES = "1.37"
# KEDA's own types are not in Kubernetes' schemas: the fields of its version 2 that the chart may use.
SCALED_JOB = {
    "failedJobsHistoryLimit",
    "jobTargetRef",
    "maxReplicaCount",
    "pollingInterval",
    "rollout",
    "scalingStrategy",
    "successfulJobsHistoryLimit",
    "triggers",
}
GPUS = {
    "accelerator": "gpu",
    "gpus": 4,
    "max": 8,
    "count": 2,
    "queue": "lab-gpus",
    "nodeSelector": {"gpu": "yes"},
    "tolerations": [{"key": "nvidia.com/gpu", "operator": "Exists", "effect": "NoSchedule"}],
    "resources": {"requests": {"cpu": "8"}, "limits": {"memory": "64Gi"}},
}
VARIANTS: dict[str, dict[str, Any]] = {
    "as it stands": {},
    "with GPUs, by KEDA": {"workers": {"any": "gpu", "pools": {"gpu": GPUS}}},
    "with GPUs, as Jobs in a queue of Kueue": {"workers": {"start": "jobs", "pools": {"gpu": GPUS}}},
    "with stores of one's own": {"stores": {"secret": "lab-stores"}},
    "as the page has it": yaml.safe_load(LAB),
    "open to a lab": {
        "image": {"registry": "registry.lab/gaitway", "tag": "main", "pullSecrets": ["registry"]},
        "api": {
            "replicas": 3,
            "allowedHosts": ["walk.lab"],
            "ingress": {
                "enabled": True,
                "className": "nginx",
                "host": "gaitway.lab",
                "tlsSecret": "gaitway-tls",
            },
        },
        "stores": {"storageClass": "fast"},
        "networkPolicy": {"enabled": False},
    },
}


@pytest.fixture(scope="module")
def chart() -> Iterator[helm_python.Chart]:
    with helm_python.Chart.load(str(CHART)) as chart:
        yield chart


def rendered(chart: helm_python.Chart, values: dict[str, Any]) -> list[dict[str, Any]]:
    files = chart.render(values, name="lab", namespace="research")
    texts = [text for name, text in files.items() if name.endswith(".yaml")]
    return [document for text in texts for document in yaml.safe_load_all(text) if document]


def of_kind(documents: list[dict[str, Any]], kind: str) -> list[dict[str, Any]]:
    return [document for document in documents if document["kind"] == kind]


def pod_templates(documents: list[dict[str, Any]]) -> Iterator[dict[str, Any]]:
    for document in documents:
        spec = document.get("spec", {})
        template = spec.get("jobTargetRef", spec).get("template")
        if template is not None:
            yield template


@pytest.mark.parametrize("variant", VARIANTS)
def test_what_is_rendered_is_valid(chart: helm_python.Chart, variant: str) -> None:
    documents = rendered(chart, VARIANTS[variant])
    places = [(document["kind"], document["metadata"]["name"]) for document in documents]
    assert len(places) == len(set(places))
    for document in documents:
        if document["kind"] == "ScaledJob":
            assert set(document["spec"]) <= SCALED_JOB
            # The Jobs that KEDA makes of it.
            document = {
                "apiVersion": "batch/v1",
                "kind": "Job",
                "metadata": document["metadata"],
                "spec": document["spec"]["jobTargetRef"],
            }
        if document["kind"] != "TriggerAuthentication":
            kubernetes_validate.validate(document, KUBERNETES, strict=True)


@pytest.mark.parametrize("variant", VARIANTS)
def test_pods_are_confined_and_their_settings_exist(chart: helm_python.Chart, variant: str) -> None:
    documents = rendered(chart, VARIANTS[variant])
    known = {*names(), "GAITWAY_SECRETS_DIR"}
    for template in pod_templates(documents):
        pod = template["spec"]
        assert pod["securityContext"]["runAsNonRoot"]
        assert not pod["automountServiceAccountToken"]
        for container in pod["containers"]:
            own = container["securityContext"]
            assert (own["readOnlyRootFilesystem"], own["allowPrivilegeEscalation"]) == (True, False)
            assert own["capabilities"] == {"drop": ["ALL"]}
            variables = {
                one["name"] for one in container.get("env", ()) if one["name"].startswith("GAITWAY_")
            }
            assert variables <= known
    for secret in of_kind(documents, "Secret"):
        files = {name.upper() for name in secret["stringData"] if name.startswith("gaitway_")}
        assert files <= known


def test_keda_asks_for_what_the_api_answers(chart: helm_python.Chart) -> None:
    jobs = of_kind(rendered(chart, VARIANTS["with GPUs, by KEDA"]), "ScaledJob")
    asked = {}
    for job in jobs:
        (trigger,) = job["spec"]["triggers"]
        assert all(isinstance(value, str) for value in trigger["metadata"].values())
        assert trigger["metadata"]["valueLocation"] in SlotsView.model_fields
        query = {
            name: value for name, (value,) in parse_qs(urlsplit(trigger["metadata"]["url"]).query).items()
        }
        asked[job["metadata"]["name"]] = SlotFilters.model_validate(query)
    assert (asked["lab-gpu"].accelerator, asked["lab-gpu"].gpus) == ("gpu", 4)
    assert (asked["lab-cpu"].accelerator, asked["lab-cpu"].gpus) == ("cpu", 0)
    assert {one.counted_as for one in asked.values()} == {"gpu"}


def test_a_worker_has_the_gpus_that_its_jobs_ask_for_and_time_to_drain(chart: helm_python.Chart) -> None:
    (job,) = (
        one
        for one in of_kind(rendered(chart, VARIANTS["with GPUs, by KEDA"]), "ScaledJob")
        if one["metadata"]["name"] == "lab-gpu"
    )
    pod = job["spec"]["jobTargetRef"]["template"]["spec"]
    (container,) = pod["containers"]
    variables = {one["name"]: one["value"] for one in container["env"]}
    assert container["resources"]["limits"] == {"nvidia.com/gpu": 4, "memory": "64Gi"}
    assert len(gpu_indices(variables["GAITWAY_DEVICE"])) == 4
    assert pod["terminationGracePeriodSeconds"] > int(variables["GAITWAY_GRACE"])
    assert job["metadata"]["labels"]["kueue.x-k8s.io/queue-name"] == "lab-gpus"


@pytest.mark.parametrize(
    "values", [{"pools": {"cpu": {"max": 0}}}, {"start": "jobs", "pools": {"cpu": {"count": 0}}}]
)
def test_a_pool_of_none_is_left_out(chart: helm_python.Chart, values: dict[str, Any]) -> None:
    documents = rendered(chart, {"workers": values})
    assert not [*of_kind(documents, "ScaledJob"), *of_kind(documents, "Job")]


def test_stores_of_ones_own_replace_all_three(chart: helm_python.Chart) -> None:
    documents = rendered(chart, VARIANTS["with stores of one's own"])
    assert not of_kind(documents, "StatefulSet")
    assert not of_kind(documents, "Secret")
    secrets = {
        volume["secret"]["secretName"]
        for template in pod_templates(documents)
        for volume in template["spec"]["volumes"]
        if "secret" in volume
    }
    assert secrets == {"lab-stores"}


@pytest.mark.parametrize(
    ("values", "sentence"),
    [
        ({"api": {"replicas": "two"}}, "at '/api/replicas': got string, want integer"),
        ({"api": {"replica": 2}}, "at '/api': additional properties 'replica' not allowed"),
        (
            {"workers": {"pools": {"a": {"accelerator": "tpu"}}}},
            "at '/workers/pools/a/accelerator': value must be",
        ),
        ({"workers": {"settings": {"MUJOCO_GL": "egl"}}}, "'MUJOCO_GL' does not match pattern"),
        ({"api": {"ingress": {"enabled": True}}}, "at '/api/ingress/host': minLength"),
    ],
)
def test_a_wrong_value_is_refused_with_its_place(
    chart: helm_python.Chart, values: dict[str, Any], sentence: str
) -> None:
    with pytest.raises(helm_python.HelmError) as refusal:
        chart.validate_schema(chart.merge_values(values))
    assert sentence in str(refusal.value)


def test_helm_finds_nothing_wrong_with_the_chart() -> None:
    found = helm_python.lint(str(CHART))
    assert found["errors"] == []
    assert [one["error"] for one in found["messages"] if one["severity"] > 1] == []
