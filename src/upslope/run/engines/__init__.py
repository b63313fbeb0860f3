"""What drives learners: compiled programs, or host environments with compiled updates."""

from upslope.run.engines.compiled import CompiledEngine
from upslope.run.engines.engine import AbstractEngine, Chunk, lay_out, pad
from upslope.run.engines.host import HostEngine

#: By the name that a learner gives as its ``engine``.
ENGINES: dict[str, AbstractEngine] = {"compiled": CompiledEngine(), "host": HostEngine()}

__all__ = ["ENGINES", "AbstractEngine", "Chunk", "CompiledEngine", "HostEngine", "lay_out", "pad"]
