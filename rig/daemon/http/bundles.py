"""The spool's bundles over HTTP: list, document, frames, skylines and answer.

Requests only select among names in the index or in ``bundle.json``; no path is built from them. The file served must
lie, links resolved, in the bundle's folder, and that in the spool.
"""

import mimetypes
from pathlib import Path, PurePosixPath
from typing import Annotated, Any, Protocol

from fastapi import APIRouter, HTTPException, Query
from fastapi import Path as PathParameter
from starlette.responses import FileResponse

from localizer.bundle import FILE_NAME, ID_PATTERN, MOST_BYTES, Bundle, BundleError, parse_bundle
from localizer.documents import DocumentError, read_file
from rig.daemon.http.models import BundleAnswer, BundleItem, Problem, bundle_answer, bundle_item
from rig.daemon.search import skylines
from rig.daemon.search.skylines import BundleSkylines
from rig.daemon.spool.index import Entry
from rig.daemon.state import Answer

BundleId = Annotated[str, PathParameter(pattern=f"^{ID_PATTERN}$", description="As in /bundles.")]
FrameFile = Annotated[
    str,
    PathParameter(pattern=r"^[0-9A-Za-z][0-9A-Za-z_.-]{0,127}$", description="As N.png: see bundle.json."),
]
Limit = Annotated[int, Query(ge=1, le=500)]

NOT_FOUND: dict[int | str, dict[str, Any]] = {
    404: {"model": Problem, "description": "There is no such thing."}
}
NEVER_CHANGES = {"Cache-Control": "private, max-age=86400, immutable"}


class BundleStore(Protocol):
    """The part of the spool that is used here (``rig.daemon.spool.store``)."""

    @property
    def bundles_dir(self) -> Path: ...

    def entries(self, limit: int, before: int | None = None) -> list[Entry]: ...

    def folder_of(self, bundle_id: str) -> Path | None: ...

    def answer_of(self, bundle_id: str) -> Answer | None: ...


def bundle_routes(spool: BundleStore) -> APIRouter:
    """All paths below /bundles."""
    router = APIRouter(tags=["bundles"])

    @router.get("/bundles")
    def bundles(
        limit: Limit = 50, before: Annotated[int | None, Query(ge=1, le=2**62)] = None
    ) -> list[BundleItem]:
        """The newest bundles, newest first; with ``before`` those with a smaller ``number``."""
        return [bundle_item(entry) for entry in spool.entries(limit, before)]

    @router.get(
        "/bundles/{bundle_id}",
        response_class=FileResponse,
        responses={200: {"model": Bundle, "description": "bundle.json as it was written."}, **NOT_FOUND},
    )
    def bundle(bundle_id: BundleId) -> FileResponse:
        """The measurement: ``skyfix.bundle/1``, raw readings and calibration with it."""
        file = file_inside(_folder(spool, bundle_id), FILE_NAME)
        return FileResponse(file, media_type="application/json", headers=NEVER_CHANGES)

    @router.get(
        "/bundles/{bundle_id}/frames/{file_name}",
        response_class=FileResponse,
        responses={
            200: {"content": {"image/png": {}}, "description": "The picture as recorded."},
            **NOT_FOUND,
        },
    )
    def frame(bundle_id: BundleId, file_name: FrameFile) -> FileResponse:
        """A frame, by the last part of its ``file`` in bundle.json."""
        folder = _folder(spool, bundle_id)
        try:
            content = read_file(file_inside(folder, FILE_NAME), MOST_BYTES)
        except DocumentError as error:
            raise BundleError(f"{bundle_id}: {FILE_NAME} {error}") from None
        except OSError as error:
            raise BundleError(f"{bundle_id}: {FILE_NAME}: {error.strerror}") from None
        document = parse_bundle(content, f"{bundle_id}: {FILE_NAME}")
        for each in document.frames:
            if PurePosixPath(each.file).name == file_name:
                kind = mimetypes.guess_type(file_name)[0] or ""
                if kind.startswith("image/") and kind != "image/svg+xml":
                    return FileResponse(
                        file_inside(folder, each.file), media_type=kind, headers=NEVER_CHANGES
                    )
        raise HTTPException(404, f"bundle {bundle_id} has no frame {file_name}")

    @router.get(
        "/bundles/{bundle_id}/skylines",
        response_class=FileResponse,
        responses={200: {"model": BundleSkylines}, **NOT_FOUND},
    )
    def lines(bundle_id: BundleId) -> FileResponse:
        """The skylines found in the frames and predicted at the answer's position; once it has been located."""
        file = file_inside(_folder(spool, bundle_id), skylines.FILE_NAME)
        return FileResponse(file, media_type="application/json")

    @router.get("/bundles/{bundle_id}/fix", responses=NOT_FOUND)
    def fix(bundle_id: BundleId) -> BundleAnswer:
        """What the bundle came to; also when its frames have been deleted to make room."""
        answer = spool.answer_of(bundle_id)
        if answer is None:
            raise HTTPException(404, f"there is no answer to a bundle {bundle_id}")
        return bundle_answer(answer)

    return router


def _folder(spool: BundleStore, bundle_id: str) -> Path:
    folder = spool.folder_of(bundle_id)
    if folder is None or folder.resolve().parent != spool.bundles_dir.resolve():
        raise HTTPException(404, f"there is no bundle {bundle_id} in the spool")
    return folder


def file_inside(folder: Path, name: str) -> Path:
    """A regular file in a folder, links resolved; 404 if it is absent or elsewhere."""
    file = (folder / name).resolve()
    if not file.is_relative_to(folder.resolve()) or not file.is_file():
        raise HTTPException(404, f"{folder.name} has no {name}")
    return file
