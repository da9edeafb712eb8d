"""flora-lab: the offline lab: tracks, models, controllers, discoveries."""

from pathlib import Path

from flora_lab.compiled_cache import use_cache_of
from flora_lab.quiet_matplotlib import say_nothing_of_its_folder

use_cache_of(Path(__file__).parent)  # before anything is compiled
say_nothing_of_its_folder()  # before matplotlib is imported
