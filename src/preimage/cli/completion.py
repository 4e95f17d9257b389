"""What a shell completes after `preimage`: verbs, the options of a verb, and names of files.

source <(preimage --completion)                                     # bash; in zsh after `autoload -U bashcompinit; bashcompinit`
"""

import contextlib
import io
import re
from collections.abc import Callable, Mapping

SCRIPT = """\
_preimage() {{
    local here=${{COMP_WORDS[COMP_CWORD]}} words=""
    if [ "$COMP_CWORD" -eq 1 ]; then
        COMPREPLY=($(compgen -W "{verbs}" -- "$here"))
        return
    fi
    case "${{COMP_WORDS[1]}}" in
{cases}
    esac
    case "$here" in
        -*) COMPREPLY=($(compgen -W "$words" -- "$here")) ;;
        *) COMPREPLY=($(compgen -f -- "$here")) ;;
    esac
}}
complete -o filenames -F _preimage preimage"""


def completion(functions: Mapping[str, Callable[..., None]]) -> str:
    """The script for bash.

    Args:
        functions: what each verb runs, from whose signature its options come.
    """
    cases = [f'        {verb}) words="{" ".join(options_of(function))}" ;;' for verb, function in functions.items()]
    return SCRIPT.format(verbs=" ".join(functions), cases="\n".join(cases))


def options_of(function: Callable[..., None]) -> list[str]:
    """The options of a verb, as its help lists them, each at the beginning of a row or after its other name."""
    import tyro

    text = io.StringIO()
    with contextlib.redirect_stdout(text), contextlib.suppress(SystemExit):
        tyro.cli(function, args=["--help"])
    rows = re.sub(r"\x1b\[[0-9;]*m", "", text.getvalue())  # in colour, whatever it is written to
    return sorted(set(re.findall(r"(?:^[│ ] |, )(--[a-z][a-z0-9.-]*)", rows, re.MULTILINE)))
