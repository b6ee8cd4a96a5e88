"""Every route has a largest form, which `bench largest` measures and the campaign's kind `largest` sends."""

import pytest

from api.app import interface
from tests.faults.campaign.largest_requests import routes


def test_every_route_has_a_largest_form() -> None:
    document = interface().openapi()
    assert len(routes(document)) > 40
    document["paths"]["/robots"] = {"get": {}}
    with pytest.raises(LookupError, match="GET /robots"):
        routes(document)
