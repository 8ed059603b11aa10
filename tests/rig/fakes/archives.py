"""Archives that are not what ``rig bundle export`` writes: what attackers, other programs and accidents make."""

import hashlib
import io
import json
import tarfile
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path

KINDS = (".tar", ".tar.gz", ".zip")
Members = Sequence[tuple[str, bytes]]


def members_of(bundle: Path, folder: str | None = None, **changed: object) -> list[tuple[str, bytes]]:
    """A bundle's files as an archive has them, in a folder that its id names; ``changed`` fields of ``bundle.json``."""
    fields = {**json.loads((bundle / "bundle.json").read_text()), **changed}
    top = str(fields["id"]) if folder is None else folder
    files = [f"{top}/bundle.json", *(f"{top}/{frame['file']}" for frame in fields["frames"])]
    contents = [json.dumps(fields).encode()]
    contents += [(bundle / frame["file"]).read_bytes() for frame in fields["frames"]]
    return list(zip(files, contents, strict=True))


def with_sums(members: Members) -> list[tuple[str, bytes]]:
    """The same with ``SHA256SUMS`` of all of them, as whoever makes an archive on purpose adds it."""
    lines = [f"{hashlib.sha256(content).hexdigest()}  {name}\n" for name, content in members]
    return [*members, ("SHA256SUMS", "".join(lines).encode())]


def write_archive_of(path: Path, members: Members) -> Path:
    """An archive with these files, whatever their names, in this order; the format is the name's."""
    if path.name.endswith(".zip"):
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, content in members:
                info = zipfile.ZipInfo("x")
                info.filename, info.compress_type = name, zipfile.ZIP_DEFLATED
                archive.writestr(info, content)
        return path
    with tarfile.open(path, "w:gz" if path.name.endswith("gz") else "w") as tar:
        for name, content in members:
            member = tarfile.TarInfo(name)
            member.size = len(content)
            tar.addfile(member, io.BytesIO(content))
    return path


def tree(folder: Path) -> Mapping[str, bytes | None]:
    """Everything below a folder, hidden files too: contents by name, None of folders and links."""
    return {
        str(path.relative_to(folder)): path.read_bytes() if path.is_file() and not path.is_symlink() else None
        for path in folder.rglob("*")
    }
