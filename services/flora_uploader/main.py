"""flora-uploader: files of record to the target, verified."""

from __future__ import annotations

from collections.abc import Sequence

from flora_common.app import App
from flora_common.service import Action, run_service
from flora_uploader.actions import show_status, upload_once
from flora_uploader.config import UploaderSection, check
from flora_uploader.service import UploaderService, watch_disk


def build(app: App[UploaderSection]) -> None:
    if app.config.target:
        UploaderService(app)
    else:
        watch_disk(app)


def main(argv: Sequence[str] | None = None) -> int:
    return run_service(
        "flora-uploader",
        UploaderSection,
        build,
        argv=argv,
        check=check,
        description="Bring every file of record to a folder, local or mounted, and prove that it is there.",
        actions=(
            Action("--once", "upload what is there, without a bus, print a summary and end", upload_once),
            Action("--status", "print what the ledger knows and end", show_status),
        ),
    )
