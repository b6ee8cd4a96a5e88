"""Lists of terms in the form: rows with search, fields and the service's own words; and their JSON."""

import json
import re
from typing import Any

import pytest
from playwright.sync_api import Page, expect

from tests.api.conftest import Stack
from tests.api.pages.conftest import Tab, flaws
from tests.api.test_models import DESCRIPTION, worker
from tests.models import identity
from tests.unit.environments.mjcf.probe import XML

# As docs/environments/robots.md has its parts.
OF_A_ROBOT: dict[str, Any] = {
    "kind": "train",
    "name": "over stairs",
    "environment": {
        "id": "go1",
        "options": {
            "command": {"kind": "velocity", "forward": [0, 1.5], "heading": [-3.1, 3.1]},
            "action": {"kind": "joint_position", "scale": {".*_hip_joint": 0.2, ".*": 0.3}},
            "events": [{"kind": "push", "every_s": 8, "speed": 0.5, "turn": 0}],
            "observation": [{"kind": "projected_gravity", "noise": 0.05}, {"kind": "command"}],
            "critic": None,
            "reset": {"keyframe": "home", "fallen": {"share": 0.5}},
            "reward": [
                {"kind": "track_linear_velocity", "weight": 2},
                {"kind": "posture", "weight": 0.1, "weights": {".*_hip_joint": 0.5, ".*": 1}},
                {"kind": "healthy", "unless": [{"kind": "upright", "least": 0.5}], "name": "stands"},
                {"kind": "undesired_contacts", "bodies": ["FR_calf", ".*L_calf"]},
            ],
            "termination": [],
            "terrain": {"kinds": ["stairs_up", "gaps"], "levels": [0, 5], "stair_height": [0.02, 0.2]},
        },
    },
    "battery": True,
    "seed": 3,
}  # fmt: skip


def sent(page: Page) -> dict[str, Any]:
    return json.loads(page.get_by_role("region", name="The submission as JSON").inner_text())


def test_a_battery_is_ticked_and_has_fields(tab: Tab) -> None:
    page = tab.open("#/submit?environment=go1")
    battery = page.get_by_role("group").filter(has=page.get_by_text("battery", exact=True)).last
    page.get_by_text("battery", exact=True).click()
    battery.get_by_label("with battery").check()
    assert sent(page)["battery"] is True
    battery.get_by_label("starts").fill("8")
    battery.get_by_text("push", exact=True).click()
    battery.get_by_label("with push").check()
    battery.get_by_label("speed", exact=True).fill("1")
    battery.get_by_text("bounds", exact=True).click()
    battery.get_by_label("falls").fill("0.1")
    expect(page.get_by_text("Checked: the service would take this.")).to_be_visible()
    assert sent(page)["battery"] == {"starts": 8, "push": {"speed": 1}, "bounds": {"falls": 0.1}}
    tab.picture("submit-battery")
    for label in ("starts", "speed", "falls"):
        battery.get_by_label(label, exact=True).fill("")
    assert sent(page)["battery"] is True
    assert flaws(page) == []
    battery.scroll_into_view_if_needed()
    tab.picture("submit-battery-narrow")
    battery.get_by_label("with battery").uncheck()
    assert "battery" not in sent(page)


def test_terms_are_searched_changed_moved_and_checked(stack: Stack, tab: Tab) -> None:
    page = tab.open("#/submit?environment=go1")
    page.get_by_text(re.compile("^reward 12 by default")).click()
    reward = page.get_by_role("group", name="reward", exact=True)
    # By keyboard: what it does is found, and the first of those found is taken.
    search = reward.get_by_label("Add to reward")
    search.fill("feet land in the air")
    expect(reward.get_by_role("option")).to_have_count(1)
    search.press("Enter")
    added = reward.get_by_role("group", name="reward 13: air_time")
    expect(added.get_by_label("weight")).to_be_focused()
    search.fill("joint acc")
    search.press("ArrowDown")
    search.press("ArrowUp")
    search.press("Enter")
    expect(
        reward.get_by_role("group", name="reward 14: joint_acceleration").get_by_label("weight")
    ).to_have_value("2.5e-7")
    rows = sent(page)["environment"]["options"]["reward"]
    assert rows[0] == {"weight": 2, "kind": "track_linear_velocity"}  # The defaults of the robot came along.
    assert rows[12:] == [{"kind": "air_time"}, {"kind": "joint_acceleration", "weight": 2.5e-7}]
    # The service refuses it at its row and its field.
    added.get_by_label("most", exact=True).fill("-1")
    expect(added.get_by_text("greater than 0")).to_be_visible()
    expect(added.get_by_label("most", exact=True)).to_have_attribute("aria-invalid", "true")
    expect(page.get_by_role("status").filter(has_text="would refuse")).to_contain_text(
        "/environment/options/reward/12/most"
    )
    added.get_by_label("most", exact=True).fill("0.4")
    expect(page.get_by_text("the service would take this")).to_be_visible()
    up = reward.get_by_role("group", name="air_time, 13 of 14").get_by_label("Move up")
    up.click()
    expect(reward.get_by_role("group", name="air_time, 12 of 14").get_by_label("Move up")).to_be_focused()
    reward.get_by_role("group", name="stand_still, 13 of 14").get_by_label("Remove").click()
    kinds = [row["kind"] for row in sent(page)["environment"]["options"]["reward"]]
    assert (len(kinds), kinds[11:]) == (13, ["air_time", "joint_acceleration"])
    # Patterns tell what they match, of names that the service knows.
    search.fill("undesired")
    search.press("Enter")
    bodies = reward.get_by_role("group", name="reward 14: undesired_contacts").get_by_label(
        "bodies", exact=True
    )
    expect(bodies).to_be_focused()
    bodies.fill(".*_calf")
    expect(reward.get_by_text(re.compile("Matches 4 of 1[34]: .*_calf"))).to_be_visible()
    tab.picture("terms-1280")
    page.set_viewport_size({"width": 380, "height": 900})
    assert (tab.violations(), tab.overflow()) == ([], 0)
    tab.picture("terms-380")
    reward.get_by_role("button", name="JSON").click()
    text = reward.get_by_label("reward as JSON")
    text.fill('[{"kind": "alive", "weigth": 1}]')
    expect(reward.get_by_text("reward.0.weigth")).to_be_visible()
    text.fill('[{"kind": "alive"')
    expect(reward.get_by_text("This is not JSON")).to_be_visible()
    expect(reward.get_by_role("button", name="Rows")).to_be_disabled()
    reward.get_by_role("button", name="Back to the default").click()
    assert "options" not in sent(page)["environment"]
    # The first field that somebody fills in keeps the defaults of its neighbours.
    page.get_by_label("every s", exact=True).first.fill("4")
    assert sent(page)["environment"]["options"] == {"command": {"kind": "velocity", "every_s": 4}}


def test_a_pasted_job_is_sent_as_it_is(stack: Stack, tab: Tab) -> None:
    page = tab.open("#/submit")
    page.get_by_text("From JSON").click()
    page.get_by_label("A job as JSON").fill(json.dumps(OF_A_ROBOT))
    page.get_by_role("button", name="Take it").click()
    assert sent(page) == OF_A_ROBOT
    page.get_by_role("button", name="Submit", exact=True).click()
    expect(page.get_by_role("heading", name="over stairs")).to_be_visible()
    [of_the_form] = stack.http.get("/jobs").json()["items"]
    assert stack.http.post("/jobs", json=OF_A_ROBOT).json()["spec"] == of_the_form["spec"]


@pytest.mark.extra
def test_the_names_of_an_own_model_are_suggested(stack: Stack, tab: Tab) -> None:
    with worker(stack, status="ready", description=DESCRIPTION):
        stack.http.post("/models", content=XML, headers={"Content-Type": "application/xml"})
    page = tab.open(f"#/submit?environment=mjcf&model={identity(XML)}")
    page.get_by_text(re.compile("^termination by default")).click()
    ends = page.get_by_role("group", name="termination", exact=True)
    ends.get_by_label("Add to termination").fill("joint_range")
    ends.get_by_label("Add to termination").press("Enter")
    joints = ends.get_by_label("joints", exact=True)
    joints.fill("elbow")
    expect(joints).to_have_attribute("list", re.compile("."))  # Once the service has told the model's parts.
    suggested = page.locator(f"[id='{joints.get_attribute('list')}'] option")
    assert "elbow" in [option.get_attribute("value") for option in suggested.all()]
    expect(ends.get_by_text("range: Field required")).to_be_visible()
