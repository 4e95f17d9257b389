"""Runs on the Hugging Face Hub: where a name that begins with `hf:` leads, and how a run gets there.

    hf:owner/name              the newest there is
    hf:owner/name@revision     a branch, a tag or a commit

Such a name always means the Hub, and no other name ever does: nothing is looked up there unless it was asked for. A folder that is
called so is reached by `./hf:owner/name`.

>>> parts_of("hf:lab/reach@v1")
('lab/reach', 'v1')
"""

import shutil
import tempfile
from pathlib import Path

import huggingface_hub
from huggingface_hub import ModelCard
from huggingface_hub.errors import (
    GatedRepoError,
    HfHubHTTPError,
    HFValidationError,
    HTTPError,
    LocalEntryNotFoundError,
    LocalTokenNotFoundError,
    RepositoryNotFoundError,
    RevisionNotFoundError,
)

from preimage.storage.run_files import CALIBRATION, MEMORY

PREFIX = "hf:"
NEEDED = ("config.json", "model.safetensors", "shown.npz")
CARD = "README.md"
KEPT_THERE = (*NEEDED, MEMORY, CALIBRATION, CARD)
"""All that is sent and fetched."""
BROKEN_OFF = HTTPError, ConnectionError
"""What a broken connection raises; the first is that of the HTTP library beneath, which is another one from version to version."""
WELL_NAMED = f"give {PREFIX}OWNER/NAME, of letters, digits, -, _ and ."
LOG_IN = "log in by `hf auth login`"


def is_meant(name: str | Path) -> bool:
    """Whether a name means the Hub; a `Path` never does."""
    return isinstance(name, str) and name.startswith(PREFIX)


def parts_of(name: str) -> tuple[str, str | None]:
    """Repository and revision of a name on the Hub.

    Raises:
        ValueError: it is no such name.
    """
    repository, at, revision = name.removeprefix(PREFIX).partition("@")
    owner, _, own = repository.partition("/")
    if not name.startswith(PREFIX) or not owner or not own or "/" in own or bool(at) != bool(revision):
        raise ValueError(f"{name} is no name on the Hugging Face Hub: give {PREFIX}OWNER/NAME, or {PREFIX}OWNER/NAME@REVISION")
    return repository, revision or None


def download(name: str) -> Path:
    """The folder of a run on the Hub, on this machine; what was fetched before and did not change is not fetched again.

    Without a connection it is what was fetched last.

    Raises:
        ValueError: there is no such repository or revision, it may not be read, or it holds no run.
        ConnectionError: the Hub cannot be reached, and the run was never fetched.
    """
    repository, revision = parts_of(name)
    try:
        folder = Path(huggingface_hub.snapshot_download(repository, revision=revision, allow_patterns=list(KEPT_THERE)))
    except HFValidationError as error:
        raise ValueError(f"{name} is no name on the Hugging Face Hub: {WELL_NAMED}") from error
    except GatedRepoError as error:
        raise ValueError(f"{name} is open to those only whom its owner lets in: ask on its page, then {LOG_IN}") from error
    except RepositoryNotFoundError as error:
        raise ValueError(f"{name} is not on the Hugging Face Hub, or is private: check the name, or {LOG_IN}") from error
    except RevisionNotFoundError as error:
        raise ValueError(f"{PREFIX}{repository} has no revision {revision}: give a branch, a tag or a commit that it has") from error
    except (LocalEntryNotFoundError, *BROKEN_OFF) as error:
        raise ConnectionError(f"{name} was not fetched before, and the Hugging Face Hub cannot be reached: try again later") from error
    if missing := [each for each in NEEDED if not (folder / each).is_file()]:
        raise ValueError(f"{name} holds no run: it has no {', no '.join(missing)}; give one that `preimage.push_to_hub` sent")
    return folder


def upload(folder: Path, repository: str, *, license: str | None, private: bool) -> str:
    """The files of a run folder are in a repository on the Hub, which is made where there is none, in one commit; its address.

    Raises:
        ValueError: a file is missing, the name is none, or nobody is logged in who may write there.
        ConnectionError: the Hub cannot be reached.
    """
    name = PREFIX + repository.removeprefix(PREFIX)
    repository, revision = parts_of(name)
    if revision:
        raise ValueError(f"{name} names a revision, and a run is sent to the newest: give {PREFIX}{repository}")
    if missing := [each for each in (*NEEDED, CARD) if not (folder / each).is_file()]:
        raise ValueError(f"{folder} has no {', no '.join(missing)}: train it to its first checkpoint before it is sent")
    with tempfile.TemporaryDirectory(prefix="preimage-") as scratch:
        draft = Path(scratch)
        for each in (*NEEDED, *(each for each in (MEMORY, CALIBRATION) if (folder / each).is_file())):
            shutil.copy(folder / each, draft)
        (draft / CARD).write_text(card_there((folder / CARD).read_text(), name, license))
        try:
            huggingface_hub.create_repo(repository, private=private, exist_ok=True)
            huggingface_hub.upload_folder(
                repo_id=repository, folder_path=draft, allow_patterns=list(KEPT_THERE), commit_message="A run of preimage"
            )
        except HFValidationError as error:
            raise ValueError(f"{name} is no name on the Hugging Face Hub: {WELL_NAMED}") from error
        except (HfHubHTTPError, LocalTokenNotFoundError) as error:
            reason = str(error).strip().splitlines()[0]
            raise ValueError(f"{name} cannot be written ({reason}): {LOG_IN}, as somebody who may write there") from error
        except BROKEN_OFF as error:
            raise ConnectionError(f"{name} cannot be written, for the Hugging Face Hub cannot be reached: try again later") from error
    return f"https://huggingface.co/{repository}"


def card_there(card: str, name: str, license: str | None) -> str:
    """The model card as it reads on the Hub: with its licence, and with the name by which everybody can plan with the run."""
    public = ModelCard(card.replace("preimage plan RUN", f"preimage plan {name}"))
    if license:
        public.data["license"] = license
    return str(public)
