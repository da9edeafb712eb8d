"""flora-lab: the offline lab: tracks, models, controllers, discoveries."""

from pathlib import Path

from flora_lab.compiled_cache import use_cache_of

use_cache_of(Path(__file__).parent)  # before anything is compiled
