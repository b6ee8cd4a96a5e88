# Made by .ci/make_client.py: change gaitway/async_client/retention.py instead.
"""What a project keeps of its ended jobs."""

from gaitway.addresses import path_of
from gaitway.client.connection import Connection
from gaitway.schema import RetentionPreviewView, RetentionView


class Retention(Connection):
    """The methods about a project's retention rules.

    `checkpoints`: of each ended job the newest so many stay. `videos_days`, `replays_days`: after so many
    days these files go; `failed_days`, `cancelled_days`: such jobs go as a whole.
    """

    def retention(self, project: str = "default") -> RetentionView:
        """The rules; `set_at` is None where the project keeps everything. Raises NotFound."""
        return self._get(_path(project), RetentionView)

    def preview_retention(
        self, project: str = "default", *, limit: int = 50, **rules: int | None
    ) -> RetentionPreviewView:
        """What these rules would remove now. limit: of the jobs that are named. Raises NotFound, Rejected."""
        path = f"{_path(project, 'preview')}?limit={limit}"
        return self._post(path, RetentionPreviewView, json=rules)

    def set_retention(self, project: str = "default", **rules: int | None) -> RetentionView:
        """Set the rules in place of those before; they are applied within the hour.

        Raises NotFound, Rejected; Conflict where an unfinished job needs what they would remove now.
        """
        answer = self._request("PUT", _path(project), json=rules)
        return RetentionView.model_validate_json(answer.content)

    def remove_retention(self, project: str = "default") -> None:
        """Keep everything from now on. Raises NotFound."""
        self._request("DELETE", _path(project))


def _path(project: str, *parts: str) -> str:
    return path_of("projects", project, "retention", *parts)
