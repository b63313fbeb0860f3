"""A coverage-guided fuzzer over the loader: ``python -m reliability.fuzz [SECONDS]``, ten minutes by default.

It needs atheris (``pip install atheris``), which the project does not require: it has no wheels for newer Pythons.
"""

import sys
import tempfile
from pathlib import Path


def main() -> None:
    """Feeds what the fuzzer thinks up to `Prior.load` and `storage.read`; any error but the typed one ends it."""
    import atheris

    with atheris.instrument_imports(include=["upslope.storage", "upslope.priors.prior"]):
        from reliability.mutations import originals
        from upslope import storage
        from upslope.errors import UpslopeError
        from upslope.priors.prior import Prior
        from upslope.run.checkpoints import FORMAT_VERSION, KIND
    seconds = int(sys.argv[1]) if len(sys.argv) > 1 else 600
    folder = Path(tempfile.mkdtemp())
    corpus = folder / "corpus"
    corpus.mkdir()
    good = {data for data, _ in originals(folder).values()}
    for number, data in enumerate(good):
        (corpus / str(number)).write_bytes(data)
    path = folder / "input"

    def one(data: bytes) -> None:
        path.write_bytes(data)
        for load in (Prior.load, lambda path: storage.read(path, KIND, FORMAT_VERSION)):
            try:
                load(path)
            except UpslopeError:
                continue
            if data not in good:
                raise AssertionError("loaded in silence")

    arguments = [sys.argv[0], str(corpus), f"-max_total_time={seconds}", "-timeout=1", "-rss_limit_mb=4096"]
    atheris.Setup(arguments, one)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
