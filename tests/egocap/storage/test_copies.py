"""Local copies of places on a store: current, in order, whole, and of one writer."""

import json
import shutil

import pytest

from egocap.data.sequence import Sequence
from egocap.errors import FileError, MachineError
from egocap.storage import copies
from egocap.storage.copies import Copy, fetch
from egocap.storage.store import Store, is_address
from egocap_sim.verification.integrity import verify


@pytest.fixture
def sent(store, tiny_sequence):
    """The address of a sequence on the store."""
    with Copy("memory://data/walk").held() as copy:
        shutil.copytree(tiny_sequence, copy.path)
        assert copy.send() == len(list(tiny_sequence.iterdir()))
    return "memory://data/walk"


def other_machine(monkeypatch, tmp_path, name="other"):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / name))


def test_addresses_are_told_from_paths_and_other_urls():
    assert all(map(is_address, ("s3://b/k", "gs://b", "memory://a/b.npz", "sftp://h/x")))
    words = (
        "walk",
        "/data/s3:/b",
        "tcp://host:8786",
        "rtsp://camera",
        "s3://",
        "http://a/b",
        "--x",
    )
    assert not any(map(is_address, words))


def test_a_sequence_is_the_same_on_another_machine(sent, monkeypatch, tmp_path):
    other_machine(monkeypatch, tmp_path)
    path = fetch(sent)
    assert path.name == "walk" and verify(path).clean
    assert len(Sequence(path)) == 7


def test_only_what_changed_is_fetched_again(sent, store, monkeypatch, tmp_path):
    other_machine(monkeypatch, tmp_path)
    path = fetch(sent)
    written = {p.name: p.stat().st_mtime_ns for p in path.iterdir()}
    (path / "scene.toml").write_text("edited here")
    store.pipe_file("/data/walk/notes.txt", b"new")
    assert fetch(sent) == path
    now = {p.name: p.stat().st_mtime_ns for p in path.iterdir()}
    assert (path / "scene.toml").read_text() != "edited here"
    assert (path / "notes.txt").read_text() == "new"
    assert {n for n in written if now[n] != written[n]} == {"scene.toml"}


def test_what_the_store_has_no_more_leaves_the_copy(sent, store, monkeypatch, tmp_path):
    store.pipe_file("/data/walk/notes.txt", b"old")
    other_machine(monkeypatch, tmp_path)
    path = fetch(sent)
    (path / "unsent.txt").write_text("written here")
    store.rm("/data/walk/notes.txt")
    with Copy(sent).held() as copy:
        copy.fetch(keep_unsent=True)  # a writer's copy keeps all
    assert (path / "notes.txt").exists()
    assert fetch(sent) == path and not (path / "notes.txt").exists()
    assert (path / "unsent.txt").read_text() == "written here"
    assert len(Sequence(path)) == 7


def test_a_file_is_fetched_and_sent(store):
    store.pipe_file("/data/a.npz", b"first")
    assert fetch("memory://data/a.npz").read_bytes() == b"first"
    with Copy("memory://data/a.npz").held() as copy:
        copy.path.write_bytes(b"second")
        assert copy.send() == 1 and copy.send() == 0
    assert store.cat_file("/data/a.npz") == b"second"


def test_nothing_there_is_said(store):
    with pytest.raises(FileError, match=r"memory://data/none: there is nothing there"):
        fetch("memory://data/none")


def test_a_damaged_shard_is_refused_until_it_is_mended(sent, store, monkeypatch, tmp_path):
    whole = store.cat_file("/data/walk/shard-00001.tar")
    store.pipe_file("/data/walk/shard-00001.tar", bytes([whole[0] ^ 1]) + whole[1:])
    other_machine(monkeypatch, tmp_path)
    with pytest.raises(FileError, match=r"'shard-00001.tar' is not as its manifest says"):
        fetch(sent)
    store.pipe_file("/data/walk/shard-00001.tar", whole)
    assert verify(fetch(sent)).clean


@pytest.mark.parametrize("name", ["../escaped", "a/../../escaped", "a\\b"])
def test_no_object_leads_out_of_the_copy(store, name, monkeypatch):
    objects = {f"/data/walk/{name}": {"name": f"/data/walk/{name}", "size": 1, "type": "file"}}
    monkeypatch.setattr(type(store), "find", lambda *_, **__: objects)
    with pytest.raises(FileError, match="names that stay in a folder"):
        Store.at("memory://data/walk").listing()


def test_an_index_is_sent_after_what_it_names(store, tiny_sequence, monkeypatch):
    order = []
    put = Store.put
    monkeypatch.setattr(Store, "put", lambda self, name, content: (
        order.append(name), put(self, name, content))[1])  # fmt: skip
    with Copy("memory://data/set").held() as copy:
        shutil.copytree(tiny_sequence, copy.path / "episode-00000")
        (copy.path / "episodes.json").write_text("{}")
        (copy.path / ".episode-00001.7.tmp").mkdir()
        (copy.path / ".episode-00001.7.tmp" / "rig.json").write_text("{}")
        copy.send()
    assert order[-1] == "episodes.json"
    manifest = order.index("episode-00000/manifest.json")
    assert manifest == len(order) - 2
    assert not any(".tmp" in name for name in order)


def test_an_unfinished_sequence_on_the_store_names_only_what_is_there(store, tiny_sequence):
    manifest = json.loads((tiny_sequence / "manifest.json").read_text())
    with Copy("memory://data/walk").held() as copy:
        copy.path.mkdir()
        for count in range(len(manifest["shards"]) + 1):
            for shard in manifest["shards"][:count]:
                shutil.copy(tiny_sequence / shard["name"], copy.path)
            text = json.dumps(manifest | {"shards": manifest["shards"][:count], "files": {}})
            (copy.path / "manifest.json").write_text(text)
            copy.send()
            there = json.loads(store.cat_file("/data/walk/manifest.json"))
            assert len(there["shards"]) == count
            assert all(store.exists(f"/data/walk/{s['name']}") for s in there["shards"])


def test_a_second_writer_elsewhere_is_noticed(sent, store, monkeypatch, tmp_path):
    with Copy(sent).held() as copy:
        copy.fetch(keep_unsent=True)
        store.pipe_file("/data/walk/manifest.json", b"{}")
        (copy.path / "manifest.json").write_text('{"mine": 1}')
        with pytest.raises(FileError, match="written by another process"):
            copy.send()


def test_what_was_not_sent_is_kept_by_the_writer(sent, store):
    with Copy(sent).held() as copy:
        (copy.path / "scene.toml").write_text("newer")
        copy.fetch(keep_unsent=True)
        assert (copy.path / "scene.toml").read_text() == "newer"
        assert copy.send() == 1
    assert store.cat_file("/data/walk/scene.toml") == b"newer"


def test_what_a_store_has_lost_is_sent_again(sent, store):
    store.rm("/data/walk/shard-00000.tar")
    with Copy(sent).held() as copy:
        assert copy.send_all() == 1
    assert store.exists("/data/walk/shard-00000.tar")


def test_a_store_that_does_not_answer_is_asked_again(sent, store, monkeypatch):
    waits, answers = [], iter([OSError("down"), TimeoutError("slow")])
    pipe = type(store).put_file

    def put(self, *args, **kwargs):
        if (error := next(answers, None)) is not None:
            raise error
        return pipe(self, *args, **kwargs)

    monkeypatch.setattr(type(store), "put_file", put)
    monkeypatch.setattr(copies.time, "sleep", waits.append)
    with Copy(sent).held() as copy:
        (copy.path / "scene.toml").write_text("newer")
        assert copy.send_all() == 1
    assert waits == [1.0, 2.0]
    monkeypatch.setattr(copies, "PATIENCE_S", 0.5)
    answers = iter([OSError("down")] * 9)
    with Copy(sent).held() as copy:
        (copy.path / "scene.toml").write_text("newest")
        with pytest.raises(MachineError, match="run the same command again to send them"):
            copy.send_all()


def test_a_file_where_a_folder_was_is_refused(sent, store):
    store.rm("/data/walk", recursive=True)
    store.pipe_file("/data/walk", b"a file")
    with pytest.raises(FileError, match="another kind of thing"):
        fetch(sent)


def test_a_damaged_state_is_built_again(sent, store):
    with Copy(sent).held() as copy:
        pass
    copy._state.write_text('{"files": [1]}')
    assert verify(fetch(sent)).clean


def test_an_unknown_package_is_named(cache):
    with pytest.raises(MachineError, match="gs://b/k"):
        Store.at("gs://b/k")
