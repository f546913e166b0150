"""Other threads of Python run while the library works, and Ctrl-C ends the waiting."""

import signal
import threading
import time

import numpy as np
import pytest

import snakeloop


def long_experiment():
    """Data whose discovery takes far longer than the wait before Ctrl-C: an hour of frames with two effects hidden."""
    index = np.arange(12000)
    theta_deg = 40 + 35 * np.sin(index / 5)
    poses = {"index": index, "time_s": index / 3, "theta_deg": theta_deg, "delta_deg": index % 360}
    effects = {"load_directed_backlash": {"play_mm": 0.08}, "rest_bend": {"x_deg": 2.0, "y_deg": 3.0}}
    return snakeloop.simulate(trajectory=poses, effects=effects)[:2]


@pytest.fixture
def interruptible():
    """A job in a shell's background starts with Ctrl-C ignored, and Python then leaves it so: the tests may be such a job."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("interruptible")
def test_ctrl_c_ends_it_and_other_threads_run_meanwhile():
    measurements, encoders = long_experiment()
    turns = 0

    def count_and_interrupt():
        nonlocal turns
        end = time.monotonic() + 0.3
        while time.monotonic() < end:
            turns += 1
            time.sleep(0.001)
        signal.raise_signal(signal.SIGINT)

    thread = threading.Thread(target=count_and_interrupt)
    start = time.monotonic()
    thread.start()
    with pytest.raises(KeyboardInterrupt):
        snakeloop.discover(measurements, encoders)
        pytest.fail("it was done before it could be interrupted")
    assert 0.3 <= time.monotonic() - start < 2.0
    # With the interpreter's lock held it would not have had a single turn.
    assert turns > 20
    thread.join()
