"""The request of a job as commands that send it again: of the command line, curl and Python."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Command:
    """A way to send a request: the name of its element on a page, its words, and its text."""

    id: str
    words: str
    text: str


def commands(spec: Mapping[str, Any], address: str, with_key: bool) -> list[Command]:
    """The commands for a service at `address`, which have a key from SCENE_ATTACK_KEY if the service asks for one.

    The request stands in them as JSON of several lines, of which none can end a here-document or a string of Python: no
    line of it is the word JSON alone, and within JSON three quotes never follow each other.
    """
    written = json.dumps(spec, indent=1, ensure_ascii=False)
    key = ' -H "Authorization: Bearer $SCENE_ATTACK_KEY"' if with_key else ""
    imports = "import json\nimport os\n\nimport httpx\n" if with_key else "import json\n\nimport httpx\n"
    headers = ', headers={"Authorization": f"Bearer {os.environ[\'SCENE_ATTACK_KEY\']}"}' if with_key else ""
    document = f"<<'JSON'\n{written}\nJSON\n"
    kind = "-H 'content-type: application/json'"
    return [
        Command("as-cli", "Command line", f"SCENE_ATTACK_URL={address} scene-attack submit --watch - {document}"),
        Command("as-curl", "curl", f"curl -s {address}/v1/jobs {kind}{key} --data-binary @- {document}"),
        Command(
            "as-python",
            "Python",
            f'{imports}\nspec = json.loads(r"""\n{written}\n""")\n'
            f'answer = httpx.post("{address}/v1/jobs", json=spec{headers}, timeout=60)\n'
            'answer.raise_for_status()\nprint(answer.json()["id"], answer.json()["state"])\n',
        ),
    ]
