"""What Prometheus is told, and what was used."""

import json
from collections.abc import Iterator
from datetime import timedelta
from pathlib import Path

import promql_parser
import pytest
import yaml
from prometheus_client.parser import text_string_to_metric_families
from prometheus_client.samples import Sample

from core.jobs.status import JobStatus
from core.jobs.tallies import ALL, PHASE_SECONDS, Tallies
from core.jobs.workers import WorkerInfo
from core.reasons import Reason
from tests.api.conftest import NOON, Attempt, Stack, job
from tests.api.problems import problem

OTHER = "019aa3c2f0b1-5be0c1d2e4"


def samples(stack: Stack) -> Iterator[Sample]:
    answer = stack.http.get("/metrics")
    assert answer.status_code == 200
    assert answer.headers["content-type"].startswith("text/plain; version=")
    for family in text_string_to_metric_families(answer.text):
        yield from family.samples


def values(stack: Stack, name: str, **labels: str) -> list[float]:
    return [
        sample.value
        for sample in samples(stack)
        if sample.name == name and labels.items() <= sample.labels.items()
    ]


def test_the_record_is_told_by_status_queue_device_and_project(stack: Stack) -> None:
    Attempt(stack, job(), worker="node1:gpu:0:a1b2c3")
    stack.store.add(job(OTHER, resources={"accelerator": "gpu", "gpus": 2}))
    info = WorkerInfo(
        name="node1:gpu:0:a1b2c3", host="node1", pid=1, device="gpu:0", started_at=NOON, seen_at=NOON
    )
    stack.store.announce(info, timedelta(minutes=1))
    found = list(samples(stack))
    told = {(sample.name, *sorted(sample.labels.items())): sample.value for sample in found}
    project = ("project", "default")
    kind = (("accelerator", "gpu"), ("gpus", "2"), ("hosts", "1"))
    assert told["gaitway_record_up",] == 1
    assert told["gaitway_jobs", project, ("status", "running")] == 1
    assert told["gaitway_jobs", project, ("status", "queued")] == 1
    assert told["gaitway_queue_jobs", *kind] == 1
    assert told["gaitway_queue_oldest_seconds", *kind] > 0
    assert told["gaitway_slots", ("device", "gpu"), ("gpus", "1"), ("state", "busy")] == 1
    assert told["gaitway_busy_gpus", project] == 1


def test_ends_and_gpu_seconds_are_counted(stack: Stack) -> None:
    attempt = Attempt(stack, job(), worker="node1:gpu:0:a1b2c3")
    attempt.end(JobStatus.FAILED, Reason.DIVERGED)
    ended = {"status": "failed", "reason": "diverged", "project": "default"}
    assert values(stack, "gaitway_jobs_ended_total", **ended) == [1]
    assert values(stack, "gaitway_attempts_ended_total", reason="diverged") == [1]
    assert 0 <= values(stack, "gaitway_gpu_seconds_total", project="default")[0] < 60


def test_what_workers_report_is_a_histogram(stack: Stack) -> None:
    tallies = Tallies()
    tallies.add(PHASE_SECONDS, 1.5, "training")
    stack.store.add_tallies(tallies.take())
    found = {s.labels.get("le"): s.value for s in samples(stack) if s.name == "gaitway_phase_seconds_bucket"}
    assert (found["1.0"], found["2.0"], found["+Inf"]) == (0, 1, 1)
    assert values(stack, "gaitway_phase_seconds_sum", phase="training") == [1.5]


def test_requests_are_counted_by_their_route_and_not_by_their_address(stack: Stack) -> None:
    route = {"method": "GET", "route": "/jobs/{job_id}", "status": "404"}
    before = sum(values(stack, "gaitway_http_requests_total", **route))
    for number in range(3):
        stack.http.get(f"/jobs/019aa3c2f0b1-5be0c1d2e{number}")
    stack.http.get("/nowhere/1")
    stack.http.request("PROPFIND", "/jobs")
    assert values(stack, "gaitway_http_requests_total", **route) == [before + 3]
    assert values(stack, "gaitway_http_requests_total", route="none", status="404")
    assert values(stack, "gaitway_http_requests_total", method="other")
    assert values(stack, "gaitway_http_request_seconds_count", route="/jobs/{job_id}")[0] >= 3


def test_an_outage_of_the_record_is_told_and_hides_only_its_numbers(stack: Stack) -> None:
    with stack.away("store"):
        assert values(stack, "gaitway_record_up") == [0]
        assert values(stack, "gaitway_jobs") == []
        assert values(stack, "gaitway_http_requests_total", route="/metrics")
    assert values(stack, "gaitway_record_up") == [1]


def test_the_record_is_read_once_in_some_seconds(stack: Stack) -> None:
    assert values(stack, "gaitway_jobs") == []
    stack.store.add(job())
    assert values(stack, "gaitway_jobs") == []


def test_openmetrics_is_answered_where_it_is_asked_for(stack: Stack) -> None:
    answer = stack.http.get("/metrics", headers={"Accept": "application/openmetrics-text; version=1.0.0"})
    assert answer.headers["content-type"].startswith("application/openmetrics-text")
    assert answer.text.endswith("# EOF\n")


def test_usage_is_told_by_project_and_device(stack: Stack) -> None:
    Attempt(stack, job(), worker="node1:gpu:0:a1b2c3").end()
    found = stack.http.get("/usage").json()
    (used,) = found["projects"]
    assert (used["project"], used["owner"], used["jobs"], used["attempts"]) == ("default", "", 1, 1)
    assert len(found["hours"]) == 24
    assert found["devices"] in (
        [],
        [{"host": "node1", "device": "gpu:0", "seconds": [0.0] * 23 + [pytest.approx(0, abs=60)]}],
    )
    longer = stack.http.get("/usage", params={"since": "2026-11-01T10:59:00+01:00"}).json()
    assert longer["since"] == "2026-11-01T09:00:00Z"


@pytest.mark.parametrize(
    ("since", "sentence"),
    [
        ("2999-01-01T00:00:00Z", "is in the future"),
        ("2026-11-01T10:00:00", "time"),
        ("yesterday", "time"),
        ("0.5", "a date and a time"),
    ],
)
def test_a_beginning_that_cannot_be_is_refused(stack: Stack, since: str, sentence: str) -> None:
    answer = stack.http.get("/usage", params={"since": since})
    found = problem(answer, 422, "invalid-request")
    assert found["errors"][0]["pointer"] == "/since"
    assert sentence in found["errors"][0]["detail"]


MONITORING = Path(__file__).parents[2] / "deploy/monitoring"
# What Grafana puts in for its variables.
VARIABLES = {"$__rate_interval": "5m", "$__range": "1h", "$project": ".*"}


def expressions() -> Iterator[tuple[str, str]]:
    """Each expression of the rules and of the dashboard, with its alert's or panel's name."""
    for group in yaml.safe_load((MONITORING / "alerts.yml").read_text())["groups"]:
        for rule in group["rules"]:
            yield rule["alert"], rule["expr"]
    dashboard = json.loads((MONITORING / "grafana/dashboard.json").read_text())
    for panel in dashboard["panels"]:
        for target in panel["targets"]:
            expression = target["expr"]
            for name, value in VARIABLES.items():
                expression = expression.replace(name, value)
            yield panel["title"], expression


def selected(expression: promql_parser.Expr) -> Iterator[tuple[str, set[str]]]:
    """Each metric that an expression reads, with the labels that it and the aggregations around it name."""
    named = list[tuple[int, set[str]]]()
    found = list[tuple[str, set[str]]]()

    def enter(node: promql_parser.Expr) -> None:
        if isinstance(node, promql_parser.AggregateExpr) and node.modifier is not None:
            named.append((id(node), set(node.modifier.labels)))
        if isinstance(node, promql_parser.VectorSelector):
            own = {matcher.name for matcher in node.matchers.matchers}
            found.append((str(node.name), own.union(*(labels for _, labels in named))))

    def leave(node: promql_parser.Expr) -> None:
        if named and named[-1][0] == id(node):
            named.pop()

    promql_parser.walk(expression, pre_visit=enter, post_visit=leave)
    yield from found


def test_alerts_and_dashboard_read_metrics_and_labels_that_there_are(stack: Stack) -> None:
    Attempt(stack, job(), worker="node1:gpu:0:a1b2c3").end()
    stack.store.add(job(OTHER))
    stack.store.beat(timedelta(seconds=14))
    info = WorkerInfo(name="w", host="h", pid=1, device="cpu", started_at=NOON, seen_at=NOON)
    stack.store.announce(info, timedelta(minutes=1))
    tallies = Tallies()
    for series in ALL:
        tallies.add(series, 1.0, *("any" for _ in series.labels))
    stack.store.add_tallies(tallies.take())
    for failed in (True, False):
        stack.instruments.observe_store("redis", 0.1, failed=failed)
    stack.http.get("/healthz")
    told = {"up": {"job", "instance"}}
    for sample in samples(stack):
        told.setdefault(sample.name, set()).update(sample.labels)
    number = 0
    for name, expression in expressions():
        for metric, labels in selected(promql_parser.parse(expression)):
            assert metric in told, f"{name}: there is no metric {metric}"
            assert labels <= told[metric], f"{name}: {metric} has no {labels - told[metric]}"
            number += 1
    assert number > 30
