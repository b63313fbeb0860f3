"""What the interpreter does while a file is loaded: no pickle, no code, no file but the one asked for."""

import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from reliability.processes import ROOT, require

_FORBIDDEN = ("pickle", "_pickle", "cloudpickle", "dill", "marshal", "shelve", "joblib")


def loading(folder: Path) -> dict[str, Any]:
    """Loads a prior and a checkpoint in a separate process, under an audit hook."""
    command = [sys.executable, "-m", "reliability.audit", str(folder)]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, check=False)
    require(done.returncode == 0, f"the audited process failed: {done.stderr[-2000:]}")
    events = json.loads(done.stdout)
    require(not events["forbidden"], f"loading did what it must not: {events['forbidden']}")
    return {"events_seen": events["seen"], "pickles_code_and_other_files": 0}


def main() -> None:
    """The audited process."""
    from reliability.mutations import originals

    folder = Path(sys.argv[1])
    with tempfile.TemporaryDirectory(dir=folder) as inside:
        copies = []
        for name, (data, load) in originals(Path(inside)).items():
            path = Path(inside) / f"audited-{name}.safetensors"
            path.write_bytes(data)
            load(path)  # once before the hook listens: JAX traces and compiles what the run needs
            copies.append((path, load))
        forbidden: list[str] = []
        seen = 0
        listening = True

        def hook(event: str, arguments: tuple[Any, ...]) -> None:
            nonlocal seen
            if not listening:
                return
            seen += 1
            if event in ("exec", "compile", "marshal.loads", "pickle.find_class", "os.system", "subprocess.Popen"):
                forbidden.append(f"{event} {str(arguments)[:100]}")
            elif event == "import" and str(arguments[0]).split(".")[0] in _FORBIDDEN:
                forbidden.append(f"import {arguments[0]}")
            elif event == "open" and not str(arguments[0]).startswith(inside) and not isinstance(arguments[0], int):
                forbidden.append(f"open {arguments[0]}")

        sys.addaudithook(hook)
        for path, load in copies:
            load(path)
        listening = False
    print(json.dumps({"seen": seen, "forbidden": forbidden}))


if __name__ == "__main__":
    main()
