"""The file that a model comes as: what may be in it, and everything that may not."""

import io
import stat
import zipfile
from pathlib import Path

import pytest

from core.environments.mjcf import archive
from core.environments.mjcf.archive import examine
from core.environments.mjcf.main_document import with_main
from core.environments.mjcf.model import read
from core.environments.task_model import compiled
from core.errors import BadModel

PLAIN = b"<mujoco><worldbody/></mujoco>"
WITH_MESH = b'<mujoco><compiler meshdir="meshes"/><asset><mesh name="foot" file="foot.stl"/></asset></mujoco>'


def zipped(files: dict[str, bytes], method: int = zipfile.ZIP_DEFLATED) -> bytes:
    body = io.BytesIO()
    with zipfile.ZipFile(body, "w", method) as packed:
        for name, content in files.items():
            packed.writestr(name, content)
    return body.getvalue()


def entry(name: str, mode: int) -> bytes:
    body = io.BytesIO()
    with zipfile.ZipFile(body, "w") as packed:
        info = zipfile.ZipInfo(name)
        info.external_attr = mode << 16
        packed.writestr(info, "/etc/passwd")
        packed.writestr("model.xml", PLAIN)
    return body.getvalue()


def refusal(body: bytes) -> str:
    with pytest.raises(BadModel) as refused:
        examine(body)
    return refused.value.detail


def test_a_zip_is_unpacked_with_its_meshes(tmp_path: Path) -> None:
    body = zipped({"robot/robot.xml": WITH_MESH, "robot/meshes/foot.stl": b"stl", "__MACOSX/x": b""})
    found = examine(body)
    assert found.unpack(tmp_path) == tmp_path / "robot/robot.xml"
    assert (tmp_path / "robot/meshes/foot.stl").read_bytes() == b"stl"
    assert not (tmp_path / "__MACOSX").exists()


def test_of_several_documents_the_one_that_nobody_includes_is_meant() -> None:
    scene = b'<mujoco><include file="robot.xml"/></mujoco>'
    assert examine(zipped({"robot.xml": PLAIN, "arena.xml": scene})).main == "arena.xml"
    both = {"one.xml": PLAIN, "two.xml": PLAIN}
    assert examine(zipped({**both, "scene.xml": PLAIN})).main == "scene.xml"
    assert examine(zipped({**both, "old/scene.xml": PLAIN, "scene.xml": PLAIN})).main == "scene.xml"


def of(main: str, files: dict[str, bytes]) -> bytes:
    """A zip that names its main document."""
    named = with_main(zipped(files), main)
    assert named is not None
    return named


def test_two_documents_that_may_be_the_model_are_named_with_their_sizes_and_one_can_be_chosen() -> None:
    both = {"a/one.xml": PLAIN, "a/two.xml": PLAIN + b"\n" * 1000}
    # 29 bytes of PLAIN; the largest comes first.
    assert "a/two.xml (1,029 bytes), a/one.xml (29 bytes)" in refusal(zipped(both))
    assert "--main FILE" in refusal(zipped(both))
    assert examine(of("a/one.xml", both)).main == "a/one.xml"
    assert examine(of("two.xml", both)).main == "a/two.xml"
    # Another choice takes the place of the one before.
    again = with_main(of("one.xml", both), "two.xml")
    assert again is not None
    assert examine(again).main == "a/two.xml"
    assert "no document 'ne.xml'; it has a/two.xml (1,029 bytes), a/one.xml" in refusal(of("ne.xml", both))
    assert "2 documents 'one.xml'" in refusal(of("one.xml", {**both, "b/one.xml": PLAIN}))
    assert with_main(b"PK\x03\x04 and no end", "one.xml") is None


def test_only_what_the_main_document_reaches_is_checked() -> None:
    robot = b'<mujoco><include file="parts/leg.xml"/></mujoco>'
    leg = b'<mujocoinclude><include file="foot.xml"/></mujocoinclude>'
    files = {
        "robot.xml": robot,
        "parts/leg.xml": leg,
        "parts/foot.xml": b"<mujocoinclude/>",
        "package.xml": b"<package/>",
        "lost.xml": WITH_MESH,
        "beside.xml": WITH_MESH.replace(b'"meshes"', b'"../meshes"'),
        "broken.xml": b"<mujoco>",
        "typed.xml": b"<!DOCTYPE m><mujoco/>",
    }
    assert examine(of("robot.xml", files)).main == "robot.xml"
    assert "outside the archive" in refusal(of("beside.xml", files))
    assert "not in the zip" in refusal(of("lost.xml", files))
    assert "broken.xml is not XML" in refusal(of("broken.xml", files))
    assert "its root is <package>" in refusal(of("package.xml", files))
    # A file of ROS about the package is no rival of the model.
    assert examine(zipped({"go.xml": PLAIN, "package.xml": b"<package/>"})).main == "go.xml"
    # Another leg.xml is not the one that is read, so that its meshes may be missing; it may climb nowhere.
    assert examine(of("robot.xml", {**files, "old/leg.xml": WITH_MESH})).main == "robot.xml"
    climbing = {**files, "old/leg.xml": WITH_MESH.replace(b"foot.stl", b"../../../secret.stl")}
    assert "outside the archive" in refusal(of("robot.xml", climbing))


def test_a_folder_for_meshes_that_no_mesh_uses_may_be_anywhere() -> None:
    scene = b'<mujoco><include file="robot.xml"/></mujoco>'
    robot = b'<mujoco><compiler meshdir="../meshes/"/></mujoco>'
    assert examine(zipped({"scene.xml": scene, "robot.xml": robot})).main == "scene.xml"


MOVING = b"<mujoco><worldbody><body><joint/><geom size='.1'/></body></worldbody></mujoco>"
LINK = b'<mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
HINGED = (
    b'<robot name="r"><link name="a"><inertial>%s</inertial></link>'
    b'<link name="b"><inertial>%s</inertial></link>'
    b'<joint name="j" type="continuous"><parent link="a"/><child link="b"/></joint></robot>'
) % (LINK, LINK)


@pytest.mark.parametrize(
    ("name", "document"), [("m.mjcf", MOVING), ("d/M.XML", MOVING), ("m.Mjcf", MOVING), ("r.URDF", HINGED)]
)
def test_a_documents_name_may_end_in_any_way_that_people_write(
    name: str, document: bytes, tmp_path: Path
) -> None:
    (tmp_path / "model").write_bytes(zipped({name: document}))
    with read(tmp_path / "model") as (spec, main):
        assert (main, compiled(spec).nv) == (name, 1)


def test_a_scene_reads_what_it_includes_by_any_such_name(tmp_path: Path) -> None:
    scene = b'<mujoco><include file="robot.mjcf"/></mujoco>'
    (tmp_path / "model").write_bytes(zipped({"scene.XML": scene, "robot.mjcf": MOVING}))
    with read(tmp_path / "model") as (spec, main):
        assert (main, compiled(spec).nv) == ("scene.XML", 1)
    attached = b'<mujoco><asset><model name="r" file="robot.mjcf"/></asset></mujoco>'
    assert "only if its name ends with .xml or .urdf" in refusal(
        zipped({"scene.xml": attached, "robot.mjcf": MOVING})
    )


def test_meshes_may_lie_beside_the_documents_folder() -> None:
    document = WITH_MESH.replace(b'meshdir="meshes"', b'meshdir="../meshes"')
    assert examine(zipped({"xml/model.xml": document, "meshes/foot.stl": b"stl"})).main == "xml/model.xml"


def test_a_urdf_names_its_meshes_as_ros_does() -> None:
    urdf = b'<robot name="r"><mesh filename="package://arm/meshes/foot.stl"/></robot>'
    assert examine(zipped({"arm.urdf": urdf, "foot.stl": b"stl"})).main == "arm.urdf"


@pytest.mark.parametrize(
    ("document", "sentence"),
    [
        (b'<!DOCTYPE m [<!ENTITY a "b">]><mujoco model="&a;"/>', "document type"),
        (b'<!DOCTYPE m SYSTEM "file:///etc/passwd"><mujoco/>', "document type"),
        (b"<mujoco>", "is not XML"),
        (b"", "is not XML"),
        (b"\xff\xfe\x00", "is not XML"),
        (b"<html/>", "its root is <html>"),
        (b'<mujoco><geom mass="nan"/></mujoco>', "mass of <geom> is nan"),
        (b'<mujoco><body pos="0 -INF 0"/></mujoco>', "pos of <body> is -INF"),
        (b"<mujoco>" + b"<body>" * 300 + b"</body>" * 300 + b"</mujoco>", "nested ones"),
        (b'<mujoco><include file="/etc/passwd"/></mujoco>', "names the file '/etc/passwd'"),
        (WITH_MESH, "send both in a zip"),
    ],
)
def test_a_document_that_may_not_be_is_refused(document: bytes, sentence: str) -> None:
    assert sentence in refusal(document)


def test_a_body_may_be_called_inf() -> None:
    assert examine(b'<mujoco><body name="inf" childclass="nan"/></mujoco>').main == "model.xml"


@pytest.mark.parametrize(
    "reference",
    [
        "/etc/passwd",
        "../../etc/passwd",
        "meshes/../../secret.stl",
        "C:/x.stl",
        "..\\x.stl",
        "file:///etc/passwd",
    ],
)
def test_a_reference_outside_the_archive_is_refused(reference: str) -> None:
    document = WITH_MESH.replace(b"foot.stl", reference.encode())
    assert "outside the archive" in refusal(zipped({"model.xml": document, "meshes/foot.stl": b""}))


@pytest.mark.parametrize("folder", ["/etc", "../..", "../secret"])
def test_a_folder_outside_the_archive_is_refused(folder: str) -> None:
    document = WITH_MESH.replace(b'"meshes"', f'"{folder}"'.encode())
    assert "outside the archive" in refusal(zipped({"model.xml": document, "meshes/foot.stl": b""}))


def test_what_is_included_cannot_leave_the_archive_by_way_of_who_includes_it() -> None:
    # MuJoCo counts what part.xml names from the folder of robot.xml.
    part = b'<mujocoinclude><asset><mesh name="foot" file="../../secret.stl"/></asset></mujocoinclude>'
    files = {
        "b/c/part.xml": part,
        "robot.xml": b'<mujoco><include file="b/c/part.xml"/></mujoco>',
        "secret.stl": b"",
    }
    assert "outside the archive" in refusal(zipped(files))
    scene = b'<mujoco><asset><model name="r" file="../../robot.xml"/></asset></mujoco>'
    assert "'../../secret.stl', which is outside" in refusal(zipped({**files, "x/y/scene.xml": scene}))
    # The main document's own are counted from its folder alone.
    robot = {"robot.xml": WITH_MESH, "meshes/foot.stl": b"", "x/y/scene.xml": scene}
    assert examine(zipped(robot)).main == "x/y/scene.xml"


@pytest.mark.parametrize("element", ["include", "model"])
def test_what_is_included_is_looked_at_whatever_it_is_called(element: str) -> None:
    part = b'<mujocoinclude><mesh file="/etc/passwd"/></mujocoinclude>'
    document = b'<mujoco><%s file="part.txt"/></mujoco>' % element.encode()
    assert "must end with .xml" in refusal(zipped({"model.xml": document, "part.txt": part}))


def test_a_file_that_is_not_there_is_named() -> None:
    assert "'foot.stl', which is not in the zip" in refusal(zipped({"model.xml": WITH_MESH}))


@pytest.mark.parametrize("name", ["/a.xml", "../a.xml", "a/../../b", "a\\b", "C:x", "a//b", "./a", "x\x07"])
def test_a_path_that_leaves_the_archive_is_refused(name: str) -> None:
    assert "is not a path inside the archive" in refusal(zipped({"model.xml": PLAIN, name: b"x"}))


@pytest.mark.parametrize("kind", [stat.S_IFLNK, stat.S_IFIFO, stat.S_IFBLK])
def test_links_and_devices_are_refused(kind: int) -> None:
    assert "is a link or a device" in refusal(entry("meshes", kind | 0o777))


def test_a_zip_bomb_is_refused_before_it_is_unpacked(monkeypatch: pytest.MonkeyPatch) -> None:
    bomb = zipped({"model.xml": PLAIN, **{f"{number}.stl": b"\0" * 2**20 for number in range(8)}})
    assert len(bomb) < 20_000
    assert "times its size" in refusal(bomb)
    monkeypatch.setattr(archive, "MAX_TOTAL_BYTES", 2**20)
    assert "Unpacked, the zip has" in refusal(bomb)


def test_a_mesh_of_200_mb_is_refused() -> None:
    body = bytearray(zipped({"model.xml": PLAIN, "foot.stl": b"stl"}))
    # The size that the directory at the end announces.
    at = body.rindex(b"PK\x01\x02") + 24
    body[at : at + 4] = (200 * 10**6).to_bytes(4, "little")
    assert "'foot.stl' has 200,000,000 bytes" in refusal(bytes(body))


def test_a_file_that_is_longer_than_announced_is_no_more_than_that() -> None:
    body = bytearray(zipped({"model.xml": PLAIN + b" " * 100_000}))
    at = body.rindex(b"PK\x01\x02") + 24
    body[at : at + 4] = (10).to_bytes(4, "little")
    assert "cannot be unpacked" in refusal(bytes(body))


def test_too_many_files_are_refused() -> None:
    assert "1,001 entries" in refusal(
        zipped({f"{number}": b"" for number in range(1001)}, zipfile.ZIP_STORED)
    )


def test_what_would_keep_the_service_busy_is_refused() -> None:
    assert "51 documents; 50 are allowed" in refusal(zipped({f"{number}.xml": PLAIN for number in range(51)}))
    folders = b"".join(b'<compiler meshdir="%d"/>' % number for number in range(9))
    assert "10 folders; 8 are allowed" in refusal(zipped({"model.xml": b"<mujoco>%s</mujoco>" % folders}))
    files = b'<mesh file="a.stl"/>' * 5001
    assert "5,001 files; 5,000 are allowed" in refusal(zipped({"model.xml": b"<mujoco>%s</mujoco>" % files}))
    assert "more than 1,000 entries" in refusal(zipped({"a": b"PK\x01\x02" * 2001}, zipfile.ZIP_STORED))


def test_names_that_differ_in_case_alone_are_refused() -> None:
    assert "more than once" in refusal(zipped({"model.xml": PLAIN, "a": b"", "A": b""}))


def test_what_no_file_system_takes_is_refused() -> None:
    both = {"model.xml": PLAIN, "meshes": b"", "meshes/foot.stl": b""}
    assert "'meshes' as a file and as a folder" in refusal(zipped(both))
    assert "too long" in refusal(zipped({"model.xml": PLAIN, "a" * 256: b""}))


@pytest.mark.parametrize(
    ("body", "sentence"),
    [
        (b"PK\x03\x04 and nothing else", "cannot be read"),
        (zipped({"readme.txt": b""}), "no .xml, .mjcf or .urdf"),
        (zipped({"model.xml": PLAIN}, zipfile.ZIP_LZMA), "`deflate`"),
        (zipped({"model.xml": PLAIN})[:-30], "cannot be read"),
    ],
)
def test_a_broken_zip_is_refused(body: bytes, sentence: str) -> None:
    assert sentence in refusal(body)


def test_an_encrypted_file_is_refused() -> None:
    body = bytearray(zipped({"model.xml": PLAIN}))
    body[body.rindex(b"PK\x01\x02") + 8] |= 1
    assert "encrypted" in refusal(bytes(body))


def test_a_damaged_file_is_refused() -> None:
    body = bytearray(zipped({"model.xml": b"<mujoco>" + bytes(range(65, 91)) * 40 + b"</mujoco>"}))
    body[60] ^= 0xFF
    assert "cannot be unpacked" in refusal(bytes(body))
