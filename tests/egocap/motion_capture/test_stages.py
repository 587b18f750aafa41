"""A stage runs again only if its settings, its input or its file changed."""

import pytest

from egocap.motion_capture.stages import Stages


@pytest.fixture
def runs(tmp_path):
    """Runs three stages with settings, the second after the first, and names those written."""

    def run(first, second, third=1):
        written = []

        def write(path):
            written.append(path.name)
            path.write_text(path.name)

        stages = Stages(tmp_path)
        assert stages.run("a.txt", {"x": first}, write, lambda p: p.read_text()) == "a.txt"
        stages.run("b.txt", {"x": second}, write, lambda p: p.read_text(), after=("a.txt",))
        stages.run("c.txt", {"x": third}, write, lambda p: p.read_text())
        return written

    return run


def test_stages_are_run_once(runs, tmp_path):
    assert runs(1, 1) == ["a.txt", "b.txt", "c.txt"]
    assert runs(1, 1) == []
    assert runs(1, 2) == ["b.txt"]
    assert runs(2, 2) == ["a.txt", "b.txt"]
    assert runs(2, 2, 3) == ["c.txt"]
    (tmp_path / "b.txt").unlink()
    assert runs(2, 2, 3) == ["b.txt"]


def test_a_stage_that_fails_is_run_again(tmp_path):
    def fail(path):
        path.write_text("half")
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        Stages(tmp_path).run("a.txt", {}, fail, lambda p: p)
    again = Stages(tmp_path).run("a.txt", {}, lambda p: p.write_text("whole"), lambda p: p)
    assert again.read_text() == "whole"
