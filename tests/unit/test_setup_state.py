"""What the set-up remembers."""

import pytest

from bootstrap.state import State, hash_of


@pytest.fixture
def file(tmp_path):
    return tmp_path / ".venv/.setup.json"


def test_finished_step_is_done_for_its_key_only(file):
    state = State(file)
    state.begin("packages", "a")
    state.finish("packages", "a")
    again = State(file)
    assert again.is_done("packages", "a")
    assert not again.is_done("packages", "b")
    assert not again.is_done("nodes", "a")
    assert not again.is_broken("packages")


def test_step_that_was_cut_off_is_broken(file):
    state = State(file)
    state.finish("packages", "a")
    state.begin("packages", "b")
    again = State(file)
    assert again.is_broken("packages")
    assert not again.is_done("packages", "a")
    assert not again.is_done("packages", "b")


@pytest.mark.parametrize("content", ["", "{", "[]", '{"packages": 3}', "null", "\x00"])
def test_unreadable_state_means_nothing_is_done(file, content):
    file.parent.mkdir()
    file.write_text(content)
    state = State(file)
    assert not state.is_done("packages", "a")
    state.finish("packages", "a")
    assert State(file).is_done("packages", "a")


def test_hash_sees_content_name_and_order(tmp_path):
    folder = tmp_path / "folder"
    folder.mkdir()
    (folder / "a").write_text("1")
    first = hash_of(folder)
    (folder / "a").write_text("2")
    second = hash_of(folder)
    (folder / "a").rename(folder / "b")
    third = hash_of(folder)
    (folder / "c").touch()
    assert len({first, second, third, hash_of(folder)}) == 4
    assert hash_of("a", "b") != hash_of("b", "a") != hash_of("ab")


def test_hash_ignores_what_python_leaves_behind(tmp_path):
    (tmp_path / "a.py").write_text("1")
    before = hash_of(tmp_path)
    (tmp_path / "__pycache__").mkdir()
    (tmp_path / "__pycache__/a.pyc").touch()
    assert hash_of(tmp_path) == before


def test_missing_file_has_a_hash_of_its_own(tmp_path):
    (tmp_path / "there").touch()
    assert hash_of(tmp_path / "there") != hash_of(tmp_path / "gone")
