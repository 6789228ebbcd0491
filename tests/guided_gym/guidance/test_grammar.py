"""The grammar of guidances: what is read, what is refused and where, and that its own text is read back."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from guided_gym.errors import InvalidInputError
from guided_gym.guidance.grammar import DEEPEST, LONGEST, Call, Option, is_name, parse, split


def call(name: str, *arguments: Any, **options: Any) -> Call:
    return Call(name, arguments, tuple(Option(*item) for item in options.items()))


A, B = Call("a"), Call("b")


@pytest.mark.parametrize(
    ("text", "tree"),
    [
        ("a", A),
        ("  a\n", A),
        ("a()", A),
        ("a + b", call("hybrid", A, B)),
        ("hybrid(a, b)", call("hybrid", A, B)),
        ("a@x=1@y=2", call("a", x=1, y=2)),
        ("a(y=2, x=1)", call("a", x=1, y=2)),
        ("a(x=1)@y=2", call("a", x=1, y=2)),
        ("a@x=1+b@y=-2.5", call("hybrid", call("a", x=1), call("b", y=-2.5))),
        ("a@x=1e+5+b", call("hybrid", call("a", x=1e5), B)),
        ("a@x=.5", call("a", x=0.5)),
        ("a(x=-inf)", call("a", x=float("-inf"))),
        ("a(x=true, y=false, z=none)", call("a", x=True, y=False, z=None)),
        ("a(x=True, y=False, z=None)", call("a", x=True, y=False, z=None)),
        ("a(x=b)", call("a", x=B)),
        ("a(x='b')", call("a", x="b")),
        ("a(x=b+c@y=1)", call("a", x=call("hybrid", B, call("c", y=1)))),
        ("a@x=b@y=1", call("a", x=B, y=1)),
        ("a@x=b(y=1)", call("a", x=call("b", y=1))),
        ("a(x=[], y=[1, 'u', [b]], z=[1,])", call("a", x=(), y=(1, "u", (B,)), z=(1,))),
        ('a(x="say ""so"", (you) [there]")', call("a", x='say "so", (you) [there]')),
        ("a(x='it''s')", call("a", x="it's")),
        ("a(x=1st, y=1e, z=1.5.2)", call("a", x=Call("1st"), y=Call("1e"), z=Call("1.5.2"))),
        ("package.module:Class(x=1)", call("package.module:Class", x=1)),
        ("learned:point@temperature=1", call("learned:point", temperature=1)),
        ('learned:"runs/a+b (2), c"+rrt', call("hybrid", Call("learned:runs/a+b (2), c"), Call("rrt"))),
        (r'learned:"C:\runs\a b"', Call(r"learned:C:\runs\a b")),
        (
            "hybrid(roadmap(robot=disc), lazy_prm(vertices=100), rule=bandit)",
            call(
                "hybrid",
                call("roadmap", robot=Call("disc")),
                call("lazy_prm", vertices=100),
                rule=Call("bandit"),
            ),
        ),
    ],
)  # fmt: skip
def test_parse__reads(text: str, tree: Call) -> None:
    assert parse(text) == tree
    assert parse(str(tree)) == tree


def test_parse__says_where_each_part_is() -> None:
    text = "hybrid(a(x=1), b@why=2)"
    tree = parse(text)
    first, second = tree.arguments
    assert text[slice(*tree.span)] == text
    assert text[slice(*first.span)] == "a(x=1)"
    assert text[slice(*second.span)] == "b@why=2"
    assert text[second.options[0].at :].startswith("why")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", r"expected a name, got its end at character 1 of ''"),
        ("a+", r"names joined by '\+', got its end at character 3 of 'a\+'"),
        ("a++b", r"names joined by '\+', got '\+b' at character 3"),
        ("+a", r"expected a name, got '\+a' at character 1"),
        ("a@", r"name@option=value, got its end at character 3"),
        ("a@x", r"name@option=value, got 'x' at character 3"),
        ("a@=1", r"name@option=value, got '=1' at character 3"),
        ("a@x=", r"expected a value, got its end at character 5"),
        ("a@1x=2", r"the name of an option, got '1x=2' at character 3"),
        ("a(x=1, x=2)", r"the option 'x' once, got 'x=2\)' at character 8"),
        ("a(x=1)@x=2", r"the option 'x' once, got 'x=2' at character 8"),
        ("a(x=1, b)", r"before those with one, got .* at character 3"),
        ("a(b", r"expected ',' or '\)', got its end at character 4"),
        ("a(b c)", r"expected ',' or '\)', got 'c\)' at character 5"),
        ("a(,)", r"expected a value, got ',\)' at character 3"),
        ("a(x=[1)", r"expected ',' or '\]', got '\)' at character 7"),
        ("a)", r"or the end .*, got '\)' at character 2"),
        ("a b", r"or the end .*, got 'b' at character 3"),
        ('a(x="b)', r"a closing quote.*, got .* at character 5"),
        ('"a"', r"expected a name, got .* at character 1"),
        ("3", r"expected a name, got '3' at character 1"),
        ("true", r"expected a name, got 'true' at character 1"),
        ("a(3(x=1))", r"expected ',' or '\)', got '\(x=1\)\)' at character 4"),
        ("a(x=" + "1" * 5000 + ")", r"a number of fewer digits, got '111111111111' at character 5"),
        ("rrt@x=[[[[", r"expected a value, got its end at character 11"),
        ("a" * LONGEST + "a", rf"at most {LONGEST} characters, got {LONGEST + 1}"),
        ("(" * 100_000, rf"at most {LONGEST} characters, got 100000"),
        ("a(" * 4000, rf"at most {DEEPEST} brackets within .*, got .* at character {2 * DEEPEST + 2}"),
        ("a@x=" + "[" * 4000, rf"at most {DEEPEST} brackets within each other"),
    ],
)  # fmt: skip
def test_parse__refuses_and_says_where(text: str, message: str) -> None:
    with pytest.raises(InvalidInputError, match=message) as caught:
        parse(text)
    assert len(str(caught.value)) < 300
    assert "\n" not in str(caught.value)


def test_parse__takes_brackets_up_to_the_limit() -> None:
    tree = parse("a(" * DEEPEST + ")" * DEEPEST)
    depth = 0
    while not tree.bare:
        (tree,) = tree.arguments
        depth += 1
    assert depth == DEEPEST - 1  # the innermost brackets are empty


@pytest.mark.parametrize(
    "folder", ["a+b", "a@test+b@test", "a=b", "a b", "a (2)", "a'b", "a, b", "point+rrt"]
)
def test_paths__that_exist_need_no_quotes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, folder: str
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "runs" / folder / "agent").mkdir(parents=True)
    whole = Call(f"learned:runs/{folder}/agent")
    assert parse(f"learned:runs/{folder}/agent") == whole
    assert parse(f' learned:"runs/{folder}/agent" ') == whole
    assert parse(str(whole)) == whole
    options = call(whole.name, temperature=1)
    assert parse(str(options)) == options
    if not set(folder) & set("(),'"):
        assert parse(f"learned:runs/{folder}/agent@temperature=1") == options
        assert parse(f"rrt+learned:runs/{folder}/agent+rrt") == call(
            "hybrid", Call("rrt"), whole, Call("rrt")
        )
        assert parse(f"a(x=runs/{folder}/agent, y=b)") == call("a", x=f"runs/{folder}/agent", y=B)
        assert parse(f"a@x=runs/{folder}/agent@y=1") == call("a", x=f"runs/{folder}/agent", y=1)


def test_paths__that_do_not_exist_are_words(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert parse("learned:runs/a+b") == call("hybrid", Call("learned:runs/a"), B)
    with pytest.raises(InvalidInputError, match="a path with such characters needs quotes"):
        parse("learned:runs/a b")


def test_canonical_text__means_the_same_whatever_lies_in_the_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    trees = [
        call("learned:a", temperature=1.0),
        call("hybrid", Call("learned:a"), B),
        call("f", x=Call("a"), y=Call("b")),
        Call("learned:a b"),
    ]
    for name in ("a(temperature=1.0)", "a, b)", "a, y=b)", "a", "a b"):
        (tmp_path / name).mkdir()
    for tree in trees:
        assert parse(str(tree)) == tree


@pytest.mark.parametrize(
    ("text", "items"),
    [
        ("", []),
        (" a ", ["a"]),
        ("a, b+c", ["a", "b+c"]),
        ("hybrid(a, b(x=[1,2])),c", ["hybrid(a, b(x=[1,2]))", "c"]),
        ("learned:\"a,b\",c@x='(',d", ['learned:"a,b"', "c@x='('", "d"]),
        ("it's,a", ["it's", "a"]),
    ],
)
def test_split__at_commas_outside_of_brackets_and_quotes(text: str, items: list[str]) -> None:
    assert split("guidance", text) == items


@pytest.mark.parametrize("text", ["a,", ",", "a,,b", "f(a),,b"])
def test_split__refuses_empty_items(text: str) -> None:
    with pytest.raises(InvalidInputError, match="guidance: expected names separated by commas"):
        split("guidance", text)


@pytest.mark.parametrize(
    "name", ["", "true", "None", "1", "1e5", "-inf", "a b", "a:b", "a+b", 'a"', "a'b", "a(", None, 3]
)
def test_is_name__refuses_what_an_expression_reads_otherwise(name: object) -> None:
    assert not is_name(name)


texts = st.text(max_size=8) | st.sampled_from(['"', "''", 'a"b', "a+b", "true", "1"])
words = st.text(max_size=6).filter(is_name)
members = words.flatmap(lambda w: texts.map(lambda t: f"{w}:{t}")) | texts.map("learned:{}".format)
names = words | members
plain = (
    texts | st.integers() | st.floats(allow_nan=False) | st.booleans() | st.none() | words.map(Call)
)  # fmt: skip
identifiers = st.from_regex(r"[a-z_][a-z0-9_]{0,5}", fullmatch=True)


def calls(values: st.SearchStrategy[Any]) -> st.SearchStrategy[Any]:
    options = st.dictionaries(identifiers, values, max_size=3)
    made = st.builds(
        lambda name, arguments, options: call(name, *arguments, **options),
        names, st.lists(values, max_size=3), options,
    )  # fmt: skip
    return made | st.lists(values, max_size=3).map(tuple)


trees = st.builds(
    lambda name, arguments, options: call(name, *arguments, **options),
    names,
    st.lists(st.recursive(plain, calls, max_leaves=8), max_size=3),
    st.dictionaries(identifiers, st.recursive(plain, calls, max_leaves=8), max_size=3),
)


def same(one: Any, other: Any) -> bool:
    """Equality that tells 1 from 1.0 and from True, and 0.0 from -0.0."""
    return repr(one) == repr(other)


def unplaced(value: Any) -> Any:
    if isinstance(value, tuple):
        return tuple(unplaced(item) for item in value)
    if isinstance(value, Call):
        options = tuple(Option(option.name, unplaced(option.value)) for option in value.options)
        return Call(value.name, unplaced(value.arguments), options)
    return value


@settings(max_examples=500, deadline=None)
@given(trees)
def test_canonical_text__is_read_back(tree: Call) -> None:
    assert same(unplaced(parse(str(tree))), unplaced(tree))


pieces = st.sampled_from(
    ["a", "hybrid", "learned:", "x=", "(", ")", "[", "]", ",", "+", "@", "=", '"', "'", ":", " ", "1", "-",
     ".5", "true", "none", "inf", "1e+5", "\n", "\0", "é", "\udc80", "…"]
)  # fmt: skip


@settings(max_examples=2000, deadline=None)
@given(st.lists(pieces, max_size=25).map("".join) | st.text(max_size=30))
def test_parse__of_any_text_gives_a_tree_or_one_clear_error(text: str) -> None:
    try:
        tree = parse(text)
    except InvalidInputError as error:
        assert "\n" not in str(error)
    else:
        assert same(unplaced(parse(str(tree))), unplaced(tree))
