from hypothesis import given
from hypothesis import strategies as st

from gaitway.views import LineReader, ServerSentEvent, Stream


def parse(lines: list[str], last_id: str = "") -> list[ServerSentEvent]:
    return Stream(last_id).take("".join(line + "\n" for line in lines).encode())


def lines(chunks: list[bytes]) -> list[str]:
    reader = LineReader()
    return [line for chunk in chunks for line in reader.take(chunk)]


def test_an_event_has_kind_data_and_id() -> None:
    assert parse(["id: 7-0", "event: status", "data: {}", ""]) == [ServerSentEvent("status", "{}", "7-0")]


def test_several_data_lines_are_one_text_and_one_leading_space_is_dropped() -> None:
    assert parse(["data:a", "data:  b", "data", ""]) == [ServerSentEvent("message", "a\n b\n", "")]


def test_the_id_stays_until_another_is_named_also_from_before_the_connection() -> None:
    events = parse(["data: a", "", "id: 2", "data: b", "", "data: c", ""], last_id="1")
    assert [event.id for event in events] == ["1", "2", "2"]


def test_comments_and_an_event_without_data_or_without_its_end_are_no_events() -> None:
    assert parse([": alive", "event: x", "", "retry: 3", "", "data: cut off"]) == []


def test_a_line_separator_inside_the_data_ends_no_line() -> None:
    assert lines(["a\u2028b\x0bc\n".encode()]) == ["a\u2028b\x0bc"]


@given(
    texts=st.lists(st.text(st.characters(exclude_characters="\r\n", exclude_categories=["Cs"]))),
    end=st.sampled_from(["\n", "\r\n", "\r"]),
    size=st.integers(1, 7),
)
def test_lines_do_not_depend_on_how_the_network_cuts_them(texts: list[str], end: str, size: int) -> None:
    # A carriage return at the very end waits for its line feed: the last line is closed by another one.
    stream = "".join(text + end for text in texts).encode()
    chunks = [stream[i : i + size] for i in range(0, len(stream), size)]
    assert lines([*chunks, b"end\n"]) == [*texts, "end"]
