"""`t2m data check` names faults in what a data set says, planted in a computed and in an imported set."""

import shutil

import numpy as np
import pytest

from t2m_jax.data.audit import audit_dataset
from t2m_jax.data.body_checks import measure_body
from t2m_jax.data.caption_checks import check_words, is_misread
from t2m_jax.data.folder import open_dataset
from t2m_jax.data.importers.bvh import import_bvh_folder
from t2m_jax.data.importers.synthetic import KINDS, make_motion, write_synthetic_dataset
from t2m_jax.data.texts import Caption, load_captions, save_captions
from t2m_jax.data.writer import mirror, write_clip
from t2m_jax.files.manifest import MANIFEST
from t2m_jax.motion.features import features_from_positions, local_positions
from t2m_jax.motion.motion import Motion
from t2m_jax.motion.skeleton import HUMANML3D

SPLITS = ("train", "val", "test")


@pytest.fixture(scope="module")
def computed(tmp_path_factory):
    """Returns a computed set."""
    folder = tmp_path_factory.mktemp("sets") / "computed"
    write_synthetic_dataset(folder, num_clips=20, seed=3)
    return folder


@pytest.fixture(scope="module")
def imported(computed):
    """Returns a set that is imported from BVH files of the clips of the computed one."""
    dataset, lines, files = open_dataset(computed), ["file,caption"], computed.parent / "files"
    files.mkdir()
    for name in sorted(name for split in SPLITS for name in dataset.names(split) if not name.startswith("M")):
        positions = np.load(dataset.folder / "new_joints" / f"{name}.npy")
        Motion(positions, HUMANML3D.fps).save(files / f"{name}.bvh")
        lines += [f'{name},"{caption.text}"' for caption in dataset.captions(name)]
    (files / "captions.csv").write_text("\n".join(lines) + "\n")
    import_bvh_folder(files, computed.parent / "imported")
    return computed.parent / "imported"


SETS = ["computed", pytest.param("imported", marks=pytest.mark.slow)]


@pytest.fixture
def folder(request, tmp_path):
    """A copy that a test may break."""
    copy = shutil.copytree(request.getfixturevalue(request.param), tmp_path / "data")
    (copy / MANIFEST).unlink()  # it would name every change
    return copy


def names_of(folder, word=""):
    """Returns the clips, or those with a word in all captions, without twins, training clips first."""
    dataset = open_dataset(folder)
    names = [name for split in SPLITS for name in dataset.names(split) if not name.startswith("M")]
    return [name for name in names if all(word in caption.text.lower() for caption in dataset.captions(name))]


def kinds_of(folder, *kinds):
    """Returns the clips of some kinds, by their number: the synthetic kinds are made in turn."""
    return [
        name for name in names_of(folder) if int(name[-5:]) % len(KINDS) in [tuple(KINDS).index(kind) for kind in kinds]
    ]


def encode_again(folder, names, change):
    """Changes the joints of clips, and writes the features that follow."""
    for name in names:
        positions = change(np.load(folder / "new_joints" / f"{name}.npy").astype(np.float32))
        captions = load_captions(folder / "texts" / f"{name}.txt")
        features = features_from_positions(positions, HUMANML3D)
        write_clip(folder, name, features, captions=captions, skeleton=HUMANML3D)


def with_twins(names):
    return [twin for name in names for twin in (name, f"M{name}")]


def exchange_sides(positions):
    order = np.arange(22)
    for pair in HUMANML3D.mirror_pairs:
        order[list(pair)] = pair[::-1]
    return positions[:, order]


def swap_all(folder):
    encode_again(folder, with_twins(names_of(folder)), exchange_sides)


def swap_one(folder):
    encode_again(folder, names_of(folder)[:1], exchange_sides)


def swap_columns(folder):
    """Exchanges left and right in the features alone, so that headings stay."""
    path = folder / "new_joint_vecs" / f"{names_of(folder)[0]}.npy"
    features, places = np.load(path), HUMANML3D.layout.positions
    local = np.concatenate([np.zeros((len(features), 1, 3)), features[:, places].reshape(-1, 21, 3)], axis=1)
    features[:, places] = exchange_sides(local)[:, 1:].reshape(len(features), -1)
    np.save(path, features)


def mirror_axis(folder):
    encode_again(folder, with_twins(names_of(folder)), lambda positions: positions * np.float32([-1, 1, 1]))


def scale(folder, names, factor):
    """Scales features; if joints were scaled and encoded again, they would get the lengths of the skeleton."""
    layout = HUMANML3D.layout
    for name in names:
        path = folder / "new_joint_vecs" / f"{name}.npy"
        features = np.load(path)
        for part in (layout.root_velocity, layout.root_height, layout.positions, layout.velocities):
            features[:, part] *= np.float32(factor)
        captions = load_captions(folder / "texts" / f"{name}.txt")
        write_clip(folder, name, features, captions=captions, skeleton=HUMANML3D)


def in_inches(folder):
    scale(folder, with_twins(names_of(folder)), 2.54)


def half_as_large(folder):
    scale(folder, names_of(folder)[:1], 0.5)


def copy_a_test_clip(folder):
    name = open_dataset(folder).names("test")[0].removeprefix("M")
    for part in ("new_joint_vecs", "new_joints", "texts"):
        (found,) = (folder / part).glob(f"{name}.*")
        shutil.copy(found, folder / part / f"other{found.suffix}")
    save_captions(folder / "texts" / "other.txt", load_captions(folder / "texts" / f"{name}.txt")[:1])
    with (folder / "train.txt").open("a") as file:
        file.write("other\n")


def copy_the_twin_of_a_test_clip(folder):
    copy_a_test_clip(folder)
    name = open_dataset(folder).names("test")[0].removeprefix("M")
    shutil.copy(folder / "new_joint_vecs" / f"M{name}.npy", folder / "new_joint_vecs" / "other.npy")
    shutil.copy(folder / "new_joints" / f"M{name}.npy", folder / "new_joints" / "other.npy")


def stand_still(folder):
    encode_again(folder, names_of(folder)[:1], lambda positions: np.repeat(positions[:1], len(positions), axis=0))


def reverse_rows(folder):
    path = folder / "new_joint_vecs" / f"{names_of(folder)[0]}.npy"
    np.save(path, np.load(path)[::-1])


def reverse_time(folder):
    encode_again(folder, kinds_of(folder, "walk"), lambda positions: positions[::-1])
    for name in kinds_of(folder, "walk"):
        captions = load_captions(folder / "texts" / f"{name}.txt")
        save_captions(folder / "texts" / f"{name}.txt", [captions[0]._replace(text="a person walks forward")])


def copy_in_the_place_of_the_twin(folder):
    name = kinds_of(folder, "wave-left-hand")[0]
    for part in ("new_joint_vecs", "new_joints"):
        shutil.copy(folder / part / f"{name}.npy", folder / part / f"M{name}.npy")


def other_clip_in_the_place_of_the_twin(folder):
    one, other = kinds_of(folder, "squat")[:2]
    encode_again(folder, [f"M{one}"], lambda _: np.load(folder / "new_joints" / f"M{other}.npy"))


def joints_aside(folder):
    path = folder / "new_joints" / f"{names_of(folder)[0]}.npy"
    np.save(path, np.load(path) + np.float32([1, 0, 0]))


def other_rate(folder):
    lines = (folder / "dataset.yaml").read_text().splitlines()
    (folder / "dataset.yaml").write_text("\n".join([*(line for line in lines if "fps" not in line), "fps: 60.0"]))


def exchange_captions(folder):
    """Gives captions to the clips that are five kinds further."""
    names = names_of(folder)
    names.sort(key=lambda name: int(name[-5:]))
    for prefix in ("", "M"):
        texts = [(folder / "texts" / f"{prefix}{name}.txt").read_text() for name in names]
        for name, text in zip(names, texts[5:] + texts[:5], strict=True):
            (folder / "texts" / f"{prefix}{name}.txt").write_text(text)


def caption_of_one_other_clip(folder):
    walking, waving = kinds_of(folder, "walk")[0], kinds_of(folder, "wave-left-hand")[0]
    shutil.copy(folder / "texts" / f"{walking}.txt", folder / "texts" / f"{waving}.txt")


def exchange_sides_in_captions(folder):
    for name in with_twins(kinds_of(folder, "raise-up-left-hand", "wave-right-hand")):
        path = folder / "texts" / f"{name}.txt"
        captions = [caption._replace(text="a person raises the left arm") for caption in load_captions(path)[:1]]
        wrong = ("left" in kind_of(name)) != name.startswith("M")
        save_captions(path, [mirror(caption) if wrong else caption for caption in captions])


def exchange_turns_in_captions(folder):
    for name in kinds_of(folder, "walk-turn-left"):
        path = folder / "texts" / f"{name}.txt"
        save_captions(path, [load_captions(path)[0]._replace(text="a person turns to the right")])


def captions_of_the_original(folder):
    name = kinds_of(folder, "walk-turn-left")[0]
    shutil.copy(folder / "texts" / f"{name}.txt", folder / "texts" / f"M{name}.txt")


def misread_captions(folder):
    path = folder / "texts" / f"{names_of(folder)[0]}.txt"
    text = path.read_text().replace("#", " in the caf\N{LATIN SMALL LETTER E WITH ACUTE}#", 1)
    path.write_text(text.encode().decode("latin-1"), encoding="utf-8")


def kind_of(name):
    return tuple(KINDS)[int(name[-5:]) % len(KINDS)]


FAULTS = {
    swap_all: "left and right are exchanged",
    swap_one: "left and right are exchanged",
    swap_columns: "left and right are exchanged",
    mirror_axis: "one axis is mirrored",
    in_inches: "2.54 times the lengths",
    half_as_large: "0.50 times the lengths",
    copy_a_test_clip: "has the motion of other, which is in train.txt",
    copy_the_twin_of_a_test_clip: "has the motion of other, which is in train.txt",
    stand_still: "nothing moves",
    reverse_rows: "time is reversed",
    reverse_time: "tells of the other direction",
    copy_in_the_place_of_the_twin: "is not the mirror image",
    other_clip_in_the_place_of_the_twin: "clip that it mirrors",
    joints_aside: "1.00 m from those of the features",
    other_rate: "fps: 60",
    exchange_captions: "captions belong to other clips",
    caption_of_one_other_clip: "stays where it is",
    exchange_sides_in_captions: "tells of the other hand",
    exchange_turns_in_captions: "tells of a turn to the other side",
    captions_of_the_original: "in a twin, left and right are exchanged",
    misread_captions: "UTF-8 that was read in another encoding",
}


@pytest.mark.parametrize("name", SETS)
def test_the_sets_have_no_fault(request, name):
    assert audit_dataset(request.getfixturevalue(name)).problems == []


@pytest.mark.parametrize("folder", SETS, indirect=True)
@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.__name__)
def test_a_fault_is_named(folder, fault):
    fault(folder)
    problems = audit_dataset(folder).problems
    assert any(FAULTS[fault] in problem for problem in problems), problems[:9]


@pytest.mark.parametrize(("walked", "problems"), [(20, 0), (0, 1)])
def test_walking_may_be_a_small_part_of_a_clip(walked, problems):
    walk = make_motion("walk", seed=4, num_frames=60)
    positions = np.concatenate([np.repeat(walk[:1], 360, axis=0), walk[: 1 + walked]])
    features = features_from_positions(positions, HUMANML3D)
    body = measure_body(features, local_positions(features, HUMANML3D), HUMANML3D)
    assert body.speed < 0.1
    assert len(check_words([Caption("a person waits and walks")], body)) == problems


@pytest.mark.parametrize(
    "text", ["a café", "ein Mann läuft", "Åsa går", "人が歩く", "don’t — “stop”", "naïve façade", "é"]
)
def test_correct_text_is_told_from_misread_text(text):
    assert not is_misread(text)
    if not text.isascii():
        assert is_misread(text.encode().decode("latin-1")) and is_misread(f"{text} \ufffd")
