"""Foreign files, links, pipes and folders of other users are kept, not followed, or refused."""

import json
import os
import pwd
import shutil
import stat
import tempfile
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from forked import call_forked

from colmap_edges.errors import ColmapEdgesError
from colmap_edges.report.rerun_viewer import check_recording_path
from colmap_edges.runtime.cache import FORGOTTEN_S, Cache
from colmap_edges.runtime.output import new_folder
from colmap_edges.runtime.ownership import EVALUATION, OUTPUT, file_sizes

ROUNDS, SOAK_ROUNDS = 60, 5000


def command(small, output, *flags):
    """The words of the command that meshes the points of the small scene, which is fast."""
    run = ["mesh", "--use_edges", "0", "--report", "0"]
    run += ["--image_path", small[0], "--input_path", small[1], "--output_path", output, *flags]
    return [os.fspath(word) for word in run]


def call(small, output, *flags):
    return call_forked(command(small, output, *flags))


def check_refused(done, *words):
    """One line that says all of `words`."""
    assert done.returncode == 1, done.stdout + done.stderr
    assert done.stderr.startswith("Error: ")
    assert done.stderr.count("\n") == 1
    for word in words:
        assert str(word) in done.stderr


@pytest.fixture(scope="module")
def meshed(small, tmp_path_factory):
    """An output; read-only by agreement."""
    output = tmp_path_factory.mktemp("meshed") / "out"
    assert call(small, output).returncode == 0
    return output


@pytest.fixture
def earlier(meshed, tmp_path):
    """A copy of the output, at `tmp_path`/out."""
    return shutil.copytree(meshed, tmp_path / "out")


def tree(folder):
    """What is below a folder: kind and content of each entry by its name."""
    found = {}
    for path in sorted(folder.rglob("*")):
        mode = path.lstat().st_mode
        content = str(path.readlink()) if path.is_symlink() else ""
        if stat.S_ISREG(mode):
            content = path.read_bytes()
        found[str(path.relative_to(folder))] = (stat.S_IFMT(mode), content)
    return found


def write_output(folder, names, kind=OUTPUT):
    """Write an output of files of these names, and its record."""
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(f"ours: {name}")
    record = {"versions": {"colmap-edges": "0.1.0"}, "files": file_sizes(folder)}
    (folder / kind.record).write_text(json.dumps(record))


# What others put into an output, and where.


def link_to_evil(path, above=1):
    evil = path.parents[above] / "evil"
    evil.mkdir(exist_ok=True)
    (evil / "precious").write_text("s")
    path.unlink(missing_ok=True)
    path.symlink_to(evil)


def link_to_own_copy(path):
    kept = path.parents[1] / "kept"
    path.rename(kept)
    path.symlink_to(kept)


FOREIGN = {
    "notes.txt": lambda path: path.write_text("mine"),
    "empty folder": lambda path: path.mkdir(),
    "pipe": os.mkfifo,
    "linked": link_to_evil,
    "mesh.ply": lambda path: path.write_text("edited"),
    "report.json": link_to_own_copy,
    "edges.ply": link_to_evil,
}


@pytest.mark.parametrize("name", FOREIGN)
def test_foreign_files_in_an_output_are_named_and_kept(small, earlier, name):
    FOREIGN[name](earlier / name)
    before = tree(earlier.parent)
    check_refused(
        call(small, earlier, "--overwrite"), earlier, name, "move it away" * (name != "report.json")
    )
    assert tree(earlier.parent) == before


@pytest.mark.parametrize(
    "report",
    [
        '{"versions": {"colmap-edges": "0.1.0"}}',
        "{}",
        "[]",
        "no json",
        '{"versions": 1}',
        '{"versions": {"colmap-edges": 1}}',
        "[" * 100_000,
    ],
)
def test_report_of_another_program_is_not_ours(small, tmp_path, report):
    mine = tmp_path / "mine"
    mine.mkdir()
    (mine / "thesis.txt").write_text("x")
    (mine / "report.json").write_text(report)
    before = tree(tmp_path)
    check_refused(call(small, mine, "--overwrite"), "not an output of colmap-edges")
    assert tree(tmp_path) == before


def test_an_evaluation_is_carried_over(small, earlier):
    (earlier / "evaluation").mkdir()
    (earlier / "evaluation" / "notes.txt").write_text("mine")
    done = call(small, earlier, "--overwrite")
    assert done.returncode == 0
    assert f"{earlier}/evaluation is kept; it belongs to the earlier output" in done.stderr
    assert (earlier / "evaluation" / "notes.txt").read_text() == "mine"
    assert [path.name for path in earlier.parent.iterdir()] == ["out"]


def test_notes_in_an_evaluation_are_named_and_kept(tmp_path):
    with new_folder(tmp_path / "evaluation", EVALUATION) as folder:
        write_output(folder, ["evaluation.md"], EVALUATION)
    with new_folder(tmp_path / "evaluation", EVALUATION, overwrite=True) as folder:
        write_output(folder, ["evaluation.md", "depth.png"], EVALUATION)
    (tmp_path / "evaluation" / "notes.txt").write_text("mine")
    before = tree(tmp_path)
    with (
        pytest.raises(ColmapEdgesError, match=r"evaluation/notes\.txt was not written by"),
        new_folder(tmp_path / "evaluation", EVALUATION, overwrite=True),
    ):
        pass
    assert tree(tmp_path) == before


def test_files_created_during_a_run_are_kept(tmp_path, caplog):
    output = tmp_path / "out"
    with new_folder(output) as folder:
        write_output(folder, ["a", "sparse/b", "only/old"])
    with new_folder(output, overwrite=True) as folder:
        write_output(folder, ["a", "sparse/b", "c"])
        (output / "sparse" / "notes.txt").write_text("mine")
        (output / "only" / "notes.txt").write_text("mine")
    names = {name for name, (kind, _) in tree(output).items() if kind == stat.S_IFREG}
    ours = {"a", "sparse/b", "c", "report.json"}
    assert names == ours | {"sparse/notes.txt", "only/notes.txt"}
    with (
        pytest.raises(ColmapEdgesError, match="out/only was not written by"),
        new_folder(output, overwrite=True),
    ):
        pass
    shutil.rmtree(output)
    with pytest.raises(ColmapEdgesError, match="exists already"), new_folder(output):
        output.mkdir()
        (output / "mine").write_text("mine")
    assert tree(tmp_path) == {"out": (stat.S_IFDIR, ""), "out/mine": (stat.S_IFREG, b"mine")}


def test_a_file_edited_during_a_run_is_kept_aside(tmp_path, caplog):
    output = tmp_path / "out"
    for edited in (False, True):
        with new_folder(output, overwrite=True) as folder:
            write_output(folder, ["a"])
            if edited:
                (output / "a").write_text("edited")
    assert (output / "a").read_text() == "ours: a"
    [kept] = tmp_path.glob("out.earlier-*")
    assert (kept / "a").read_text() == "edited"
    assert f"kept in {kept}" in caplog.text
    with new_folder(output, overwrite=True) as folder:
        write_output(folder, ["a"])
    assert (kept / "a").read_text() == "edited"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out", kept.name]


def test_a_list_of_files_leads_nowhere_else(tmp_path):
    """Whatever a record lists, nothing outside of its folder goes."""
    (tmp_path / "precious").write_text("s")
    output = tmp_path / "out"
    with new_folder(output) as folder:
        record = {"versions": {"colmap-edges": "0.1.0"}, "files": {}}
        record["files"] = {"../precious": 1, str(tmp_path / "precious"): 1, "gone": 3}
        (folder / "report.json").write_text(json.dumps(record))
    with new_folder(output, overwrite=True) as folder:
        write_output(folder, ["a"])
    assert (tmp_path / "precious").read_text() == "s"
    assert sorted(path.name for path in output.iterdir()) == ["a", "report.json"]


# Links and folders where a run puts its own.


def planted_work(tmp_path, *, with_lock):
    work = tmp_path / ".out.colmap-edges"
    for name in ("new", "previous"):
        (work / name).mkdir(parents=True)
        (work / name / "precious").write_text("s")
    if with_lock:
        (work / "lock").write_text("")
    return work


def check_work_refused(tmp_path, reason):
    before = tree(tmp_path)
    with pytest.raises(ColmapEdgesError, match=reason), new_folder(tmp_path / "out"):
        pass
    assert tree(tmp_path) == before


@pytest.mark.parametrize("kind", ["file", "link", "folder", "without a lock", "with notes"])
def test_what_is_no_work_folder_is_named_and_kept(tmp_path, kind):
    work = tmp_path / ".out.colmap-edges"
    if kind == "file":
        work.write_text("mine")
    elif kind == "link":
        link_to_evil(work, above=0)
    elif kind == "folder":
        work.mkdir()
        (work / "precious").write_text("s")
    else:
        planted_work(tmp_path, with_lock=kind == "with notes")
        (work / "notes.txt").write_text("mine")
    check_work_refused(tmp_path, r"\.out\.colmap-edges is in the way of the output .* move it away")


@pytest.mark.parametrize("at", ["lock", "previous", "new"])
def test_links_in_place_of_work_are_not_followed(tmp_path, at):
    work = planted_work(tmp_path, with_lock=True)
    shutil.rmtree(work / "previous")  # it would come back as the output
    (work / at).rename(tmp_path / "evil") if at != "previous" else (tmp_path / "evil").mkdir()
    (work / at).symlink_to(tmp_path / "evil")
    before = tree(tmp_path / "evil"), (tmp_path / "evil").lstat().st_mode
    with suppress(ColmapEdgesError), new_folder(tmp_path / "out") as folder:
        write_output(folder, ["a"])
    assert (tree(tmp_path / "evil"), (tmp_path / "evil").lstat().st_mode) == before
    assert (work / at).is_symlink()


@pytest.mark.parametrize("filled", [True, False])
def test_a_link_at_the_output_is_refused(small, tmp_path, filled):
    (tmp_path / "evil").mkdir()
    if filled:
        (tmp_path / "evil" / "precious").write_text("s")
    (tmp_path / "out").symlink_to("evil")
    before = tree(tmp_path)
    check_refused(call(small, tmp_path / "out", "--overwrite"), "is a link to evil")
    assert tree(tmp_path) == before
    (tmp_path / "evil").rename(tmp_path / "gone")
    check_refused(call(small, tmp_path / "out"), "is a link to evil")
    assert not (tmp_path / "evil").exists()


def test_a_link_at_the_evaluation_is_refused(tmp_path):
    link_to_evil(tmp_path / "evaluation", above=0)
    before = tree(tmp_path)
    with (
        pytest.raises(ColmapEdgesError, match="is a link to"),
        new_folder(tmp_path / "evaluation", EVALUATION, overwrite=True),
    ):
        pass
    assert tree(tmp_path) == before


def test_cache_folders_are_not_links_and_keep_foreign_files(tmp_path, caplog):
    old = (1, 1)
    (tmp_path / "cache" / "unfinished").mkdir(parents=True)
    draft = tmp_path / "cache" / "unfinished" / "draft.txt"
    draft.write_text("mine")
    os.utime(draft, old)
    cache = Cache(tmp_path / "cache")
    assert FORGOTTEN_S > 1
    assert draft.read_text() == "mine"
    link_to_evil(tmp_path / "cache" / "edges")
    assert not cache.save("edges", "ab" * 32, {"a": np.zeros(3)})
    assert "is a link" in caplog.text
    assert [path.name for path in (tmp_path / "evil").iterdir()] == ["precious"]
    os.utime(tmp_path / "evil" / "precious", old)
    (tmp_path / "second").mkdir()
    (tmp_path / "second" / "unfinished").symlink_to(tmp_path / "evil")
    with pytest.raises(ColmapEdgesError, match="cannot use cache"):
        Cache(tmp_path / "second")
    assert (tmp_path / "evil" / "precious").exists()


# Many at once.


def plant(rng, folder):
    """Put something of ours or of others at a random place in a folder; give its path."""
    path = folder / str(rng.choice(["a", "b", "sparse/c", "sparse/d", "x", "sparse/y", "z/w"]))
    path.parent.mkdir(exist_ok=True)
    if os.path.lexists(path):
        if path.is_file() and rng.random() < 0.5:
            path.write_text(f"edited {rng.integers(1 << 30)} {'x' * rng.integers(9)}")
        return
    kind = rng.integers(4)
    if kind == 0:
        path.write_text(f"mine {rng.integers(1 << 30)}")
    elif kind == 1:
        path.symlink_to(folder.parent / "evil")
    elif kind == 2:
        os.mkfifo(path)
    else:
        path.mkdir()
        (path / "mine").write_text(f"mine {rng.integers(1 << 30)}")


def others(folder):
    """Contents and kinds of what is below a folder and not ours, however it is named."""
    return sorted(
        (kind, str(content))
        for kind, content in tree(folder).values()
        if kind in (stat.S_IFLNK, stat.S_IFIFO) or str(content).startswith(("b'mine", "b'edited"))
    )


def test_random_foreign_files_are_never_lost(tmp_path, soak, show):
    """Before, during and after runs that end well or not, all of others' things stay somewhere."""
    refused = 0
    for seed in range(SOAK_ROUNDS if soak else ROUNDS):
        rng = np.random.default_rng(seed)
        base = tmp_path / str(seed)
        (base / "evil").mkdir(parents=True)
        (base / "evil" / "precious").write_text("mine: precious")
        output = base / "out"
        with new_folder(output) as folder:
            write_output(folder, ["a", "b", "sparse/c", "sparse/d"])
        for _ in range(3):
            for _ in range(rng.integers(3) * (rng.random() < 0.3)):
                plant(rng, output)
            expected = others(base)
            try:
                with new_folder(output, overwrite=True) as folder:
                    write_output(folder, ["a", "sparse/c", *["e"] * int(rng.integers(2))])
                    for _ in range(rng.integers(3)):
                        plant(rng, output)
                    expected = others(base)
                    if rng.random() < 0.2:
                        raise RuntimeError
            except RuntimeError:
                pass
            except ColmapEdgesError:
                refused += 1
            assert others(base) == expected, seed
        shutil.rmtree(base)
    show(f"outputs with planted things: {3 * (seed + 1)} runs, {refused} refused")
    assert refused > ROUNDS // 10


# Other users' folders, pipes and devices.


@pytest.fixture
def shared(small):
    """A folder that all may look into, with the small scene."""
    folder = Path(tempfile.mkdtemp())
    folder.chmod(0o755)
    for name, source in zip(("images", "sparse"), small, strict=True):
        shutil.copytree(source, folder / name)
    yield folder
    shutil.rmtree(folder)


@pytest.fixture
def as_nobody(shared):
    """A folder of another user, and a function that calls as that user."""
    if os.geteuid() != 0:
        pytest.skip("only root can become another user")
    who = pwd.getpwnam("nobody")

    def call(output, *flags):
        words = command((shared / "images", shared / "sparse"), output, *flags)
        return call_forked(words, user=(who.pw_uid, who.pw_gid))

    mine = shared / "nobody's"
    mine.mkdir()
    os.chown(mine, who.pw_uid, who.pw_gid)
    return mine, call


def test_folders_of_another_user(shared, as_nobody, meshed):
    mine, call = as_nobody
    check_refused(call(shared / "out"), "cannot write to", "Permission denied")
    (shared / "closed").mkdir(mode=0o700)
    check_refused(call(shared / "closed" / "out"), "cannot write to", "Permission denied")
    shutil.copytree(meshed, mine / "root's")
    check_refused(call(mine / "root's", "--overwrite"), mine / "root's", "is not writable")
    (mine / "unread").mkdir(mode=0o700)
    unread = call(mine / "unread", "--overwrite")
    assert (unread.returncode, "is not readable" in unread.stderr) == (2, True)
    cached = call(mine / "out", "--cache_path", shared / "closed" / "cache")
    check_refused(cached, "cannot use cache", "Permission denied")
    before = tree(mine)
    done = call(mine / "out")
    assert done.returncode == 0, done.stderr
    assert before.items() <= tree(mine).items()
    assert (mine / "out" / "mesh.ply").stat().st_uid == mine.stat().st_uid != 0


def test_a_work_folder_of_another_user_is_left_alone(as_nobody):
    mine, call = as_nobody
    work = planted_work(mine, with_lock=True)
    work.chmod(0o777)
    before = tree(work)
    check_refused(call(mine / "out"), work, "not a work folder of yours; move it away")
    assert tree(work) == before


@pytest.mark.parametrize("overwrite", [[], ["--overwrite"]])
def test_pipes_and_devices_are_no_place_to_write(small, tmp_path, overwrite):
    os.mkfifo(tmp_path / "pipe")
    for output in (tmp_path / "pipe", Path("/dev/null"), Path("/dev/full")):
        check_refused(call(small, output, *overwrite), "a file of that name exists")
    check_refused(call(small, tmp_path / "pipe" / "out", *overwrite), "is not a folder")
    cached = call(small, tmp_path / "out", "--cache_path", tmp_path / "pipe", *overwrite)
    check_refused(cached, "cannot use cache")
    os.mkfifo(tmp_path / "pipe.rrd")
    (tmp_path / "null.rrd").symlink_to("/dev/null")
    for name, kind in (("pipe.rrd", "a pipe"), ("null.rrd", "a link")):
        recorded = call(small, tmp_path / "out", "--rerun", tmp_path / name, *overwrite)
        check_refused(recorded, name, kind)
    assert stat.S_ISFIFO((tmp_path / "pipe.rrd").stat().st_mode)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("place", ["images", "sparse", "masks", "cache", "images/below"])
def test_no_recording_among_the_inputs(tmp_path, place):
    inputs = [tmp_path / name for name in ("images", "sparse", "masks", "cache")]
    (tmp_path / place).mkdir(parents=True)
    with pytest.raises(ColmapEdgesError, match="inside or around the input"):
        check_recording_path(tmp_path / place / "x.rrd", tmp_path / "out", False, inputs)


def test_a_recording_among_the_images_is_refused(small):
    done = call(small, small[0].parent / "never", "--rerun", small[0] / "x.rrd")
    check_refused(done, "inside or around the input", small[0])
