"""Work that is spread over copies of a process: the same results, each item once, errors and deaths.

In a process of its own each: this one has JAX, and then nothing is spread.
"""

import json
import signal
import sys

import pytest
from answers import shell

from dynappo.evaluate import spread as spread_lib

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="copies are made on Linux alone")
SCRIPT = """
import json, os, signal, sys, time
from dynappo.evaluate import spread as spread_lib
spread_lib.cores = lambda: {cores}
told, first = [], os.getpid()
def work(item):
    {work}
def run():
    return spread_lib.spread(work, {items}, lambda *what: told.append(what))
{run}
alive = os.path.exists(f"/proc/{{first}}/task/{{first}}/children")
children = open(f"/proc/{{first}}/task/{{first}}/children").read().split() if alive else []
print(json.dumps(dict(result=result, told=told, first=first, children=children)))
"""


def spread(work, items, cores=3, run="result = run()"):
    done = shell("-c", SCRIPT.format(work=work, items=items, cores=cores, run=run))
    assert done.returncode == 0 and done.stderr == "", done.stderr
    return json.loads(done.stdout)


def test_copies_do_each_item_once_and_the_results_keep_their_order():
    found = spread("time.sleep(0.02 * (item % 3)); return item * item, os.getpid()", "range(9)")
    assert [square for square, _ in found["result"]] == [i * i for i in range(9)]
    who = {pid for _, pid in found["result"]}
    assert len(who) == 3 and found["first"] not in who
    assert found["told"] == [[i, 9] for i in range(10)] and not found["children"]


def test_a_thousand_items_are_each_done_once():
    found = spread("return item", "range(1000)")
    assert found["result"] == list(range(1000)) and len(found["told"]) == 1001


def test_on_one_core_this_process_works_alone():
    found = spread("return os.getpid()", "range(3)", cores=1)
    assert set(found["result"]) == {found["first"]}
    assert found["told"] == [[0, 3], [1, 3], [2, 3], [3, 3]]


def test_what_a_killed_copy_leaves_is_done_here():
    """One copy dies at the second item; the items after it are not lost."""
    work = (
        "item == 1 and os.getpid() != first and os.kill(os.getpid(), signal.SIGKILL); return item"
    )
    found = spread(work, "range(6)")
    assert found["result"] == list(range(6)) and found["told"][-1] == [6, 6]


def test_an_error_is_the_one_that_the_work_raises():
    run = """
try:
    run()
except FloatingPointError as error:
    result = str(error)
"""
    found = spread(
        "if item == 2: raise FloatingPointError('blown up')\n    return item", "range(5)", run=run
    )
    assert found["result"] == "blown up" and not found["children"]


def test_ctrl_c_leaves_no_copy():
    run = """
signal.alarm(0)
signal.signal(signal.SIGALRM, lambda *_: os.kill(first, signal.SIGINT))
signal.setitimer(signal.ITIMER_REAL, 0.5)
try:
    run()
except KeyboardInterrupt:
    result = "stopped"
"""
    found = spread("time.sleep(60)", "range(4)", run=run)
    assert found["result"] == "stopped" and not found["children"]


def test_copies_end_with_a_process_that_is_killed():
    """Each has more to send than a pipe has room for."""
    run = """
import threading
threading.Timer(1.0, lambda: os.kill(first, signal.SIGKILL)).start()
run()
"""
    work = "time.sleep(0.3); return bytes(10**6)"
    code = SCRIPT.format(work=work, items="range(10**4)", cores=3, run=run)
    done = shell("-c", code)  # it waits until no process has its output open
    assert done.returncode == -signal.SIGKILL


def test_trials_and_changes_are_the_same_on_any_number_of_cores():
    """To the bit: a short grid, two walks, both tours."""
    code = """
import hashlib, json, sys
from dynappo.evaluate import changes, spread, trials
from dynappo.policy import policy_file, policy_source
from dynappo.config import files
spread.cores = lambda: {}
policy = policy_file.load(files.find("robots", "go1/policy.npz"))
player = policy_source.player(policy)[0]
numbers, recordings = trials.run(policy, 0.3, 2, player=player)
digest = hashlib.sha256(b"".join(r["qpos"].tobytes() for r in recordings.values())).hexdigest()
print(json.dumps([numbers, digest, changes.run(player, 9, 3), changes.tours(player)]))
assert "jax" not in sys.modules
"""
    one, two = (shell("-c", code.format(cores)) for cores in (1, 2))
    assert one.returncode == 0 and one.stdout == two.stdout, one.stderr + two.stderr
    assert json.loads(one.stdout)[2]["changes"] == 9


def test_where_jax_has_begun_nothing_is_copied():
    assert "jax" in sys.modules
    assert spread_lib.spread(lambda item: (item, id(spread_lib)), [1, 2]) == [
        (1, id(spread_lib)),
        (2, id(spread_lib)),
    ]
