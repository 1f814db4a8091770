"""Where every key of a TOML text stands, and what --set replaces."""

import tomllib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vgmpi.runtime.config import toml_scan, toml_source
from vgmpi.runtime.config.schema import SceneError, TomlError
from vgmpi.runtime.config.toml_scan import MAX_NESTING, locate_keys
from vgmpi.runtime.config.toml_source import TomlSource

TEXT = '''# comment with = and [brackets]
title = "a # b = [c]"
long = """
[not.a.table]
fake = 1 \\""" still
"""
raw = \'\'\'
x = "2"\'\'\'
[domain]
size = [ "1 m",  # one
  2,
  # nothing
  3 ]
wall = { default = "slip", bottom = { kind = "stick" }, list = [ { a = 1 },
  { a = 2 } ] }
"a.b".c = 1979-05-27 07:32:00
[[object]]
name = "k ] }"
[object.shape]
box = [[1,2,3],
 [4,5,6]]
[[object]]
name = 'last'
[[object.part]]
n = 1
[[object.part]]
n = 2
'''


def test_lines_of_all_kinds_of_values():
    where = locate_keys(TEXT)
    expected = {
        ("title",): 2,
        ("long",): 3,
        ("raw",): 7,
        ("domain",): 9,
        ("domain", "size"): 10,
        ("domain", "size", 0): 10,
        ("domain", "size", 1): 11,
        ("domain", "size", 2): 13,
        ("domain", "wall", "bottom", "kind"): 14,
        ("domain", "wall", "list", 0, "a"): 14,
        ("domain", "wall", "list", 1, "a"): 15,
        ("domain", "a.b", "c"): 16,
        ("object", 0): 17,
        ("object", 0, "shape", "box", 1, 2): 21,
        ("object", 1, "name"): 23,
        ("object", 1, "part", 0, "n"): 25,
        ("object", 1, "part", 1, "n"): 27,
    }
    assert {path: where.get(path) for path in expected} == expected
    assert not any("fake" in path or "not" in path for path in where)


def paths(value, prefix=()):
    items = value.items() if isinstance(value, dict) else enumerate(value)
    for key, inner in items:
        yield (*prefix, key)
        if isinstance(inner, dict | list):
            yield from paths(inner, (*prefix, key))


def test_every_path_of_the_data_has_a_line():
    assert set(paths(tomllib.loads(TEXT))) == set(locate_keys(TEXT))


WORDS = st.text("ab=#[]{},.'\\ \t", max_size=8)
VALUES = st.one_of(
    st.integers(-9, 9).map(str),
    WORDS.map(lambda w: '"' + w.replace("\\", "\\\\").replace("\t", " ") + '"'),
    WORDS.map(lambda w: "'" + w.replace("'", "") + "'"),
    st.lists(st.integers(0, 9), max_size=3).map(lambda v: "[\n" + ",\n".join(map(str, v)) + "]"),
    st.just("{ x = 1, y = [2, { z = '}' }] }"),
    st.just('"""\n a = 1 ""\n"""'),
)


@given(st.lists(st.tuples(st.booleans(), VALUES), min_size=1, max_size=8))
def test_generated_texts(pieces):
    text = ""
    for k, (header, value) in enumerate(pieces):
        text += f"[[t]] # {k}\n" if header else ""
        text += f"key{k} = {value}  # = [\n"
    where = locate_keys(text)
    assert set(paths(tomllib.loads(text))) == set(where)
    lines = text.splitlines()
    for path, line in where.items():
        if isinstance(path[-1], str) and path[-1].startswith("key"):
            assert lines[line - 1].startswith(path[-1])


@pytest.fixture
def scene(tmp_path):
    path = tmp_path / "scene.toml"
    path.write_text(TEXT)
    return path


def test_set_replaces_by_name_and_number(scene):
    source = TomlSource(
        scene, ["object.last.size=2 cm", "object.0.shape.box.0.1=7", "new.key=true"]
    )
    assert source.data["object"][1]["size"] == "2 cm"
    assert source.data["object"][0]["shape"]["box"] == [[1, 7, 3], [4, 5, 6]]
    assert source.data["new"] == {"key": True}
    assert source.place(("object", 1, "size"))[1] == "--set object.last.size=2 cm"
    assert source.place(("object", 0, "shape", "box", 0, 1))[1].startswith("--set object.0.shape")
    assert source.place(("object", 0, "shape", "box", 0, 2))[1] == f"{scene}:20"
    assert source.overridden(("new", "key")) and not source.overridden(("title",))


@pytest.mark.parametrize(
    "item, says",
    [
        ("title", "expected key=value"),
        ("=3", "expected key=value"),
        ("object.nobody.x=1", "object has no item 'nobody'; it has k ] }, last"),
        ("object.7.x=1", "object has no item '7'"),
        ("title.x=1", "title is not a table"),
        ("domain.size.9=1", "domain.size has no item '9'; it has 3 items"),
    ],
)
def test_set_that_cannot_be_applied(scene, item, says):
    with pytest.raises(SceneError) as caught:
        TomlSource(scene, [item])
    assert caught.value.lines == [f"--set {item}: {says}"] or says in caught.value.lines[0]
    assert caught.value.lines[0].startswith(f"--set {item}: ")


@pytest.mark.parametrize(
    "content, says",
    [
        (b"a = 1\nb = = 2\n", ":2: not valid TOML: Invalid value (column 5)"),
        (b"a = 1\na = 2\n", ":2: not valid TOML: Cannot overwrite a value"),
        (b"a = [1,\n2\n", ":2: not valid TOML: "),
        (b"a = 1\nend = 0.6 s\n", '(column 11); a value with a unit needs quotes: "0.6 s"'),
        (b"size = ['1 cm', 2 cm] # m", '; a value with a unit needs quotes: "2 cm"'),
        (b"angle = -1.5e2 deg # 2 m", '; a value with a unit needs quotes: "-1.5e2 deg"'),
        (b"share = 10%", '; a value with a unit needs quotes: "10%"'),
        (b"a = 1\nkind = fluid\n", ":2: not valid TOML: Invalid value (column 8); a word needs"),
        (b"a = '\xff'", ": not UTF-8 text (byte 5)"),
        (b"a = " + b"[" * 5000, ":1: cannot be read: nested more than 32 levels deep"),
    ],
)
def test_files_that_are_no_toml(tmp_path, content, says):
    path = tmp_path / "broken.toml"
    path.write_bytes(content)
    with pytest.raises(SceneError) as caught:
        TomlSource(path)
    assert len(caught.value.lines) == 1 and "\n" not in caught.value.lines[0]
    assert caught.value.lines[0].startswith(str(path)) and says in caught.value.lines[0]


@pytest.mark.parametrize(
    "line", ["a = 5 apples", "a = true b", "a = = 2", 'a = "2 cm', 'a = "2 s" 3']
)
def test_no_hint_where_quotes_do_not_help(tmp_path, line):
    (tmp_path / "a.toml").write_text(line)
    with pytest.raises(SceneError, match="not valid TOML") as caught:
        TomlSource(tmp_path / "a.toml")
    assert "needs quotes" not in caught.value.lines[0]


def test_missing_file_and_folder(tmp_path):
    for path in (tmp_path / "none.toml", tmp_path):
        with pytest.raises(SceneError, match="No such file|is no regular file"):
            TomlSource(path)


def test_one_table_where_a_list_may_stand(tmp_path):
    """What reads the file counts it as number 0; who wrote it did not."""
    path = tmp_path / "a.toml"
    path.write_text("[camera]\n\nfov = 1\n[[probe]]\nname = 'p'\nobject = 'ball'\n\nx = 1\n")
    source = TomlSource(path)
    wrong = [(("camera", 0, "fov"), "is odd"), (("probe", 0, "object", 0), "is odd")]
    assert source.lines([*wrong, (("probe", 0, "x"), "is odd")]) == [
        f"{path}:3: camera.fov: is odd",
        f"{path}:6: probe.p.object: is odd",
        f"{path}:8: probe.p.x: is odd",
    ]


def test_who_reads_the_file_says_what_is_raised(tmp_path):
    class OtherError(TomlError):
        pass

    path = tmp_path / "broken.toml"
    path.write_text("a = = 1")
    with pytest.raises(OtherError, match=":1: not valid TOML"):
        TomlSource(path, error=OtherError)
    with pytest.raises(OtherError, match="--set b: expected key=value"):
        TomlSource(path, ["b"], text="a = 1", error=OtherError)


LONG = "9" * 5000


@pytest.mark.parametrize(
    "text, says",
    [
        (f"a = 1\nb = {LONG}", ":2: not valid TOML: an integer must fit in 64 bits"),
        (f"a = 0x{'f' * 5000}", ":1: a: must fit in 64 bits; got one of 20000 bits"),
        (f"\na = [1, -{2**63 + 1}]", ":2: a.1: must fit in 64 bits; got one of 64 bits"),
        ("\na = " + "[" * 101 + "]" * 101, ":2: cannot be read: nested more than 32 levels deep"),
        ("a" + ".a" * 300 + " = 1", ":1: cannot be read: nested more than 32 levels deep"),
        (
            "[[object]]\na" + " . 'a'" * 300 + " = 1",
            ":2: cannot be read: nested more than 32 levels deep",
        ),
        ("[a" + ".a" * 33 + "]\n", ":1: cannot be read: nested more than 32 levels deep"),
        ("[a" + ".a" * 28 + "]\na.a.a.a.a = 1", ":1: a.a.a: is nested more than 32 levels"),
        (
            "a = " + "{ a = " * 33 + "1" + "}" * 33,
            ":1: cannot be read: nested more than 32 levels deep",
        ),
    ],
)
def test_numbers_and_nesting_beyond_all_measure(tmp_path, text, says):
    path = tmp_path / "a.toml"
    path.write_text(text)
    with pytest.raises(SceneError) as caught:
        TomlSource(path)
    (line,) = caught.value.lines
    assert line.startswith(f"{path}{says}") and len(line) < 300


@pytest.mark.parametrize(
    "text, line",
    [
        ("a = 1\nb = [" + "1," * 90 + "]", 2),
        ("a = [\n" + "[],\n" * 60 + "]", 25),
        ("".join(f"a{k} = 1\n" for k in range(60)), 37),
        ("# a\n[[a]]\n[[a]]\n" * 60, 18),
        ("a = {" + ", ".join(f"b.c{k} = 1" for k in range(60)) + "}", 1),
    ],
)
def test_what_a_file_holds_is_bounded(tmp_path, monkeypatch, text, line):
    """Before a parser sees it: parsed, some forms take a thousand times their letters."""
    monkeypatch.setattr(toml_scan, "MAX_ITEMS", 75)
    monkeypatch.setattr(toml_source.tomllib, "loads", None)
    path = tmp_path / "a.toml"
    path.write_text(text)
    with pytest.raises(SceneError, match="has more than 75 lines, keys and items") as caught:
        TomlSource(path)
    assert abs(int(str(caught.value).split(":")[1]) - line) <= 14


@pytest.mark.parametrize(
    "text",
    [
        'a = "' + "[,=." * 90 + '\\"[["',
        "a = '" + "[,=." * 90 + "'",
        'a = """' + "[,\n=." * 90 + '\\"""[["""""',
        "a = '''" + "[,\n=.' " * 90 + "'''''",
        "# " + "[,=.\"'" * 90 + "\na = 1 # " + "[" * 90,
        "a = 'b'" + "\n" * 400 + "b = 1979-05-27T07:32:00.5\nc = 1.5e3",
    ],
)
def test_strings_and_comments_hold_what_they_like(tmp_path, monkeypatch, text):
    monkeypatch.setattr(toml_scan, "MAX_ITEMS", 75)
    path = tmp_path / "a.toml"
    path.write_text(text)
    assert "a" in TomlSource(path).data


def test_no_depth_of_nesting_is_too_much_to_be_told(tmp_path):
    """Also where the text can be parsed and the lines of its keys are not found any more."""
    path = tmp_path / "a.toml"
    for depth in range(MAX_NESTING - 1, 200):
        path.write_text("a = " + "[" * depth + "]" * depth)
        if depth <= MAX_NESTING:
            assert TomlSource(path).data
            continue
        with pytest.raises(SceneError, match="nested"):
            TomlSource(path)


def test_numbers_beyond_all_measure_on_the_command_line(scene):
    assert (
        TomlSource(scene, [f"new={LONG}"]).data["new"] == LONG
    )  # a text: to be refused where read
    for item, says in (
        (f"new=0x{'f' * 5000}", "new: must fit in 64 bits; got one of 20000 bits"),
        (f"object.{LONG}.x=1", "object has no item"),
        ("new=" + "[" * 200 + "]" * 200, "new: nested more than 32 levels deep"),
        ("new" + ".a" * 200 + "=1", "nested more than 32 levels deep"),
    ):
        with pytest.raises(SceneError) as caught:
            TomlSource(scene, [item])
        (line,) = caught.value.lines
        assert line.startswith(f"--set {item[:197]}...: ") and says in line


def test_a_nul_in_the_name_of_a_file():
    with pytest.raises(SceneError, match=r"^a\\x00b.toml: no file has such a name$"):
        TomlSource("a\0b.toml")


def test_errors_hold_nothing_that_a_terminal_obeys(tmp_path):
    path = tmp_path / "a\x1b[31m.toml"
    path.write_text('"a b" = 1\n"c\\u001b[31m\\nd" = 2\n[[object]]\nname = "\\r"\n')
    source = TomlSource(path)
    shown = f"{tmp_path}/a\\x1b[31m.toml"
    said = [(("c\x1b[31m\nd",), "got 'é\u202e'"), (("a b",), "is odd")]
    assert source.key(("a b", "", "c.d", 0)) == 'a b.""."c.d".0'
    assert source.lines(said) == [
        f"{shown}:1: a b: is odd",
        f"{shown}:2: c\\x1b[31m\\nd: got 'é\\u202e'",
    ]
    with pytest.raises(SceneError, match=r"^--set a\\x1b: expected key=value"):
        TomlSource(path, ["a\x1b"])
    path.write_text("\x1b")
    with pytest.raises(SceneError) as caught:
        TomlSource(path)
    assert caught.value.lines[0].startswith(f"{shown}:1: not valid TOML: ")
    assert caught.value.lines[0].isprintable()
