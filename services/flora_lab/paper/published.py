"""What Wahby et al. 2018 tell, from the start of the paper to its end: facts only, each with its section.

A number stands here once; whoever compares (:mod:`flora_lab.paper.rows`) names it by its key.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from flora_lab.dataset.recipe import PAPER_VECTORS
from flora_lab.evaluate.gap import REAL_PLANTS
from flora_lab.evolve.task import LEFT, MIDDLE
from flora_lab.evolve_report.paper_results import BEST_PERCENT
from flora_lab.train.paper import PAPER_EPOCHS, PAPER_MAE

BEAN = "Background and Related Work"
SETUP = "Bio-hybrid setup"
EXPERIMENTS = "Dataset experiments"
TRACKING = "Stem motion tracking"
MODEL = "LSTM trained as Stem stiffening and motion model"
CONTROLLER = "Controller setup"
TASK = "Task: Obstacle avoidance by shaping the plant"
EVOLUTION = "Evolutionary approach"
SIMULATED = "Evolving controllers in simulation"
REALITY = "Performance of controllers in reality"
DISCUSSION = "Discussion and Conclusion"


@dataclass(frozen=True, slots=True)
class Published:
    """A quantity that the paper tells.

    Attributes:
        key: names it for programs.
        section: of the paper.
        what: the quantity, as a person reads it.
        values: one number, or several of a kind.
        unit: empty for a plain number.
        sign: before the numbers: ``about``, ``below``.
    """

    key: str
    section: str
    what: str
    values: tuple[float, ...]
    unit: str = ""
    sign: str = ""


_PERCENT: Final = 100.0

PUBLISHED: Final = (
    Published("growth_cm_per_day", BEAN, "growth of a bean", (3.0,), "cm/day", "about"),
    # Bio-hybrid setup
    Published("box_cm", SETUP, "grow box: width, depth, height", (120.0, 120.0, 200.0), "cm"),
    Published("pot_l", SETUP, "pot", (1.5,), "l"),
    Published("leds_per_strip", SETUP, "LEDs of a lamp", (144.0,)),
    Published("led_wavelength_nm", SETUP, "peak emission of red, green, blue", (630.0, 530.0, 475.0), "nm"),
    Published("led_lumen", SETUP, "light of an LED, at most", (18.0,), "lm"),
    Published("led_power_w", SETUP, "power of an LED", (0.24,), "W"),
    Published("lamp_height_cm", SETUP, "lamps above the soil", (30.0,), "cm"),
    Published("lamp_distance_cm", SETUP, "lamps to either side", (35.0,), "cm"),
    Published("camera_height_cm", SETUP, "height of the camera", (32.0,), "cm"),
    Published("camera_distance_cm", SETUP, "camera from the plant", (74.0,), "cm"),
    Published("flash_height_cm", SETUP, "flash above the ground", (80.0,), "cm"),
    # Dataset experiments
    Published("open_loop_runs", EXPERIMENTS, "runs with regular switching", (6.0,)),
    Published("closed_loop_runs", EXPERIMENTS, "runs with a controller that follows the tip", (3.0,)),
    Published("switching_h", EXPERIMENTS, "regular switching every", (6.0,), "h"),
    Published("interval_min", EXPERIMENTS, "a photograph every", (5.0,), "min"),
    # Stem motion tracking
    Published("stem_points", TRACKING, "points of a stem", (10.0,)),
    Published("picture_share", TRACKING, "photographs are made smaller to", (0.125,), "of their size"),
    Published("theta_1", TRACKING, "threshold of plant pixels, theta 1", (0.2,)),
    Published("theta_2_px", TRACKING, "band of rows, theta 2", (30.0,), "px"),
    # Preparation of stem data
    Published("theta_3", MODEL, "nearest tips that noise is from, theta 3", (100.0,)),
    Published("omega", MODEL, "scale of the noise, omega", (0.1,)),
    Published("noise_sequences", MODEL, "noisy copies of the data", (3.0,)),
    Published("translations", MODEL, "translations of the smoothest movements", (64.0,)),
    Published("translation_exponents", MODEL, "their sizes 10^lambda, lambda", (-3.0, -4.0, -5.0, -6.0)),
    Published("jump_times", MODEL, "a jump is a change so many times the mean", (20.0,)),
    Published("vectors", MODEL, "vectors of the training set", (float(PAPER_VECTORS),)),
    # Training procedure
    Published("lstm_layers", MODEL, "inputs, LSTM cells, outputs", (19.0, 50.0, 18.0)),
    Published("split_percent", MODEL, "training, validation, test", (70.0, 20.0, 10.0), "%"),
    Published("batch", MODEL, "batch", (30.0,)),
    Published("learning_rate", MODEL, "learning rate of Adam", (0.001,)),
    Published("most_epochs", MODEL, "epochs, at most", (200.0,)),
    Published("patience", MODEL, "patience", (10.0,), "epochs"),
    Published("epochs", MODEL, "training stopped at epoch", (float(PAPER_EPOCHS),)),
    Published("loss_train", MODEL, "training loss when it stopped", (1.56e-3,)),
    Published("loss_validate", MODEL, "validation loss when it stopped", (1.55e-3,)),
    Published("mae_train", MODEL, "mean absolute error, training set", (PAPER_MAE["train"],)),
    Published("mae_validate", MODEL, "mean absolute error, validation set", (PAPER_MAE["validate"],)),
    Published("mae_test", MODEL, "mean absolute error, test set", (PAPER_MAE["test"],)),
    Published("mae_mm", MODEL, "the same at each coordinate", (1.0,), "mm", "about"),
    # Controller setup and task
    Published("controller_inputs", CONTROLLER, "inputs: stem, target, obstacle", (20.0, 2.0, 4.0)),
    Published("target_radius_cm", TASK, "radius of the target", (2.0,), "cm"),
    Published("left_target_cm", TASK, "left target: x, height", (-5.12, 17.9), "cm"),
    Published("obstacle_size_cm", TASK, "size of the obstacle", (7.0, 3.0), "cm"),
    Published("left_obstacles_cm", TASK, "its centres with the left target: x", (-8.24, -5.57, -2.90, 2.43), "cm"),
    Published("middle_target_cm", TASK, "middle target: x, height", (0.0, 17.9), "cm"),
    Published("middle_obstacles_cm", TASK, "obstacle's centres with the middle target: x", (3.0, -3.0), "cm", "about"),
    Published("obstacle_height_cm", TASK, "height of these centres", (8.8,), "cm"),
    Published("threshold", EVOLUTION, "output up to which the left lamp shines", (0.5,)),
    Published("stop_height_cm", EVOLUTION, "a run ends with the tip at a height of", (21.0,), "cm", "about"),
    Published("hours_to_stop", EVOLUTION, "which real beans reach after", (72.0,), "h", "about"),
    # Evolving controllers in simulation
    Published("evolution_runs", SIMULATED, "runs of evolution", (20.0,)),
    Published("generations", SIMULATED, "generations of each", (1000.0,)),
    Published("left_converged", SIMULATED, "left target: converged around generation", (500.0,), "", "about"),
    Published("left_fitness", SIMULATED, "left target: fitness of one of the best", (BEST_PERCENT[LEFT.name],), "%"),
    Published("left_hours", SIMULATED, "left target: simulated hours at the last picture", (6.5,), "h"),
    Published("middle_converged", SIMULATED, "middle target: converged around generation", (350.0,), "", "about"),
    Published(
        "middle_fitness", SIMULATED, "middle target: fitness of one of the best", (BEST_PERCENT[MIDDLE.name],), "%"
    ),
    Published("middle_hours", SIMULATED, "middle target: simulated hours at the last picture", (7.2,), "h"),
    # Performance of controllers in reality
    Published("reality_obstacle_cm", REALITY, "obstacle's centre: x, height", (-6.3, 12.5), "cm"),
    Published("reality_plants", REALITY, "plants", (3.0,)),
    Published("right_light_h", REALITY, "first plant: right light at first for", (37.0,), "h", "about"),
    Published("tip_at_switch_cm", REALITY, "its tip then: x, height", (7.4, 15.4), "cm"),
    Published("to_middle_h", REALITY, "from there to the middle in", (2.0,), "h", "below"),
    Published("left_light_h", REALITY, "left light at last for", (37.0,), "h"),
    Published("reality_fitness", REALITY, "fitness", tuple(_PERCENT * value for value in REAL_PLANTS), "%"),
    Published("best_fitness", REALITY, "best fitness on the way, of the second plant", (99.3,), "%"),
    Published("reality_hours", REALITY, "experiments with the first two lasted", (75.0,), "h"),
    Published("slow_above_h", REALITY, "the third, slow plant is above the obstacle in hour", (84.0,), "h"),
    Published("slow_end_h", REALITY, "and collapses in hour", (198.0,), "h"),
    # Discussion and Conclusion
    Published("more_generations", DISCUSSION, "generations to converge beyond a task without obstacle", (300.0,)),
)
"""In the order of the paper."""

LEFT_PICTURES_H: Final = (0.0, 4.0, 6.5)
"""Simulated hours of the stems in its figure, left target; the first is the start (:data:`SIMULATED`)."""
MIDDLE_PICTURES_H: Final = (2.5, 4.8, 7.2)
"""The same, middle target."""
REALITY_PICTURES_H: Final = (20.0, 37.0, 54.0, 71.0)
"""Hours of the photographs in its last figure (:data:`REALITY`)."""
