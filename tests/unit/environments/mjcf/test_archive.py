"""The file that a model comes as: what may be in it, and everything that may not."""

import io
import stat
import zipfile
from pathlib import Path

import pytest

from core.environments.mjcf import archive
from core.environments.mjcf.archive import examine
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
    assert "call the main one scene.xml" in refusal(zipped(both))
    assert examine(zipped({**both, "scene.xml": PLAIN})).main == "scene.xml"


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
    assert "more than 50 documents" in refusal(zipped({f"{number}.xml": PLAIN for number in range(51)}))
    folders = b"".join(b'<compiler meshdir="%d"/>' % number for number in range(9))
    assert "more than 8 folders" in refusal(zipped({"model.xml": b"<mujoco>%s</mujoco>" % folders}))
    files = b'<mesh file="a.stl"/>' * 5001
    assert "more than 5,000 files" in refusal(zipped({"model.xml": b"<mujoco>%s</mujoco>" % files}))
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
        (zipped({"readme.txt": b""}), "no .xml or .urdf"),
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
