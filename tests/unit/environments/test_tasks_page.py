"""The page of every term."""

from core.environments import describe_terms


def test_the_page_of_terms_is_made_from_the_classes() -> None:
    """Otherwise: `python -m core.environments.describe_terms`."""
    assert describe_terms.PAGE.read_text() == describe_terms.page()
