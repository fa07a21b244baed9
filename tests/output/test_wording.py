"""Numbers in sentences."""

from output.wording import agreeing, counted


def test_one_thing_and_several() -> None:
    assert [counted(n, "stroke") for n in (0, 1, 2)] == ["0 strokes", "1 stroke", "2 strokes"]
    assert [counted(n, "step is", "steps are") for n in (1, 2)] == ["1 step is", "2 steps are"]


def test_words_that_agree_with_a_number() -> None:
    text = "{count} [text was|texts were] left out, see [it|them] (a[0] stays, [so] too)"
    assert agreeing(text, 1) == "{count} text was left out, see it (a[0] stays, [so] too)"
    assert agreeing(text, 0) == agreeing(text, 5) == "{count} texts were left out, see them (a[0] stays, [so] too)"
