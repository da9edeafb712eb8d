"""The paper's training in the paper's stack: Keras' `fit` on TensorFlow. Runs in .venv-bench-keras, not the rig's.

    .venv-bench-keras/bin/python tests/bench/training/keras_fit.py DATA.npz --threads 1

DATA.npz holds `inputs` (n, 19), `outputs` (n, 18), and the weights to start from in Keras' order: `kernel` (19, 200),
`recurrent` (50, 200), `bias` (200,), `dense` (50, 18), `dense_bias` (18,); all float32. It says one JSON object a line:
first, when one epoch in the order of the rows is done and all is compiled, versions and that epoch's loss; then, for
each line that it hears, the seconds of one more epoch, shuffled. It ends with its input.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time

os.environ["KERAS_BACKEND"] = "tensorflow"
os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "2")

import keras
import numpy as np
import tensorflow

CELLS = 50
BATCH = 30
LEARNING_RATE = 1e-3


class Stopwatch(keras.callbacks.Callback):
    """Seconds from the first batch of an epoch to its end: what `fit` does before and after is not counted."""

    def on_epoch_begin(self, epoch: int, logs: object = None) -> None:
        self.began_s = time.perf_counter()

    def on_epoch_end(self, epoch: int, logs: object = None) -> None:
        self.seconds = time.perf_counter() - self.began_s


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data")
    parser.add_argument("--threads", type=int, default=0, help="0 leaves it to TensorFlow")
    options = parser.parse_args()
    if options.threads:
        tensorflow.config.threading.set_intra_op_parallelism_threads(options.threads)
        tensorflow.config.threading.set_inter_op_parallelism_threads(options.threads)
    keras.utils.set_random_seed(1)
    with np.load(options.data) as archive:
        data = {name: archive[name] for name in archive.files}
    inputs, outputs = data["inputs"][:, None, :], data["outputs"]
    model = keras.Sequential(
        [keras.Input((1, inputs.shape[2])), keras.layers.LSTM(CELLS), keras.layers.Dense(outputs.shape[1])]
    )
    model.compile(optimizer=keras.optimizers.Adam(LEARNING_RATE), loss="mae")
    model.set_weights([data[name] for name in ("kernel", "recurrent", "bias", "dense", "dense_bias")])
    stopwatch = Stopwatch()

    def epoch(*, shuffle: bool) -> float:
        done = model.fit(inputs, outputs, batch_size=BATCH, epochs=1, shuffle=shuffle, verbose=0, callbacks=[stopwatch])
        return float(done.history["loss"][0])

    loss = epoch(shuffle=False)
    versions = {"keras": keras.__version__, "tensorflow": tensorflow.__version__}
    say({"loss": loss, "versions": versions})
    for _ in sys.stdin:
        loss = epoch(shuffle=True)
        say({"seconds": stopwatch.seconds, "loss": loss})


def say(what: dict[str, object]) -> None:
    print(json.dumps(what), flush=True)


if __name__ == "__main__":
    main()
