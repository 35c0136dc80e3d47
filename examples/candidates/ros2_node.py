"""A ROS 2 node as a candidate: the dive is played to it, and what it publishes is recorded.

    program = ["python3", "./ros2_node.py", "{dive}", "{start}", "{solution}"]

It needs a sourced ROS 2 and the `mcap` storage of rosbag2. Put your node in `NODE`, and its topic of
`nav_msgs/msg/Odometry` in `TOPIC`. Runs at the same time need different domains: each run takes its own.

A fourth argument names the setup file of a workspace, such as `./before/install/setup.bash`. The node is then the one
that is built there, so that two workspaces are two versions of a filter.
"""

import json
import math
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

NODE = ["ros2", "run", "robot_localization", "ekf_node", "--ros-args", "--params-file", "ekf.yaml"]
# The IMU of the dive has forward-starboard-down axes, ROS has forward-left-up.
TRANSFORM = [
    "ros2",
    "run",
    "tf2_ros",
    "static_transform_publisher",
    "--roll",
    "3.14159265",
    "--child-frame-id",
    "imu",
]
TOPIC = "/odometry/filtered"
SETTLE_S, SPEED = 3.0, 10.0


def parameters(start):
    """Return the start as parameters of robot_localization: east-north-up, and the velocity in the body."""
    north, east, down = start["velocity_ned_mps"]
    roll, pitch, heading = map(math.radians, start["roll_pitch_heading_deg"])
    forward, left = (
        north * math.cos(heading) + east * math.sin(heading),
        north * math.sin(heading) - east * math.cos(heading),
    )
    state = [
        0.0,
        0.0,
        0.0,
        roll,
        -pitch,
        math.pi / 2.0 - heading,
        forward,
        left,
        -down,
        *[0.0] * 6,
    ]
    return ["-p", "use_sim_time:=true", "-p", f"initial_state:={state}"]


def of_workspace(command, setup):
    """Return a command that runs in a workspace, by its setup file; without one the command as it is."""
    if setup is None:
        return command
    return ["bash", "-c", 'source "$0" && exec "$@"', setup, *command]


def stop(running):
    """Interrupt all commands, as Ctrl-C does: `ros2 run` alone would not pass the signal on to its node."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # this process is in the group, too
    os.killpg(0, signal.SIGINT)
    for process in running:
        process.wait()


def main(dive, start, solution, setup=None):
    """Play a dive to the node."""
    if os.getpgrp() != os.getpid():
        os.setpgid(0, 0)  # a group of its own, with the commands that it starts
    environment = os.environ | {"ROS_DOMAIN_ID": str(1 + os.getpid() % 100)}
    with tempfile.TemporaryDirectory() as folder:
        bag = Path(folder, "bag")
        commands = [
            of_workspace([*NODE, *parameters(json.loads(Path(start).read_text()))], setup),
            [*TRANSFORM, "--frame-id", "base_link"],
            ["ros2", "bag", "record", "--storage", "mcap", "--output", str(bag), TOPIC],
        ]
        running = [subprocess.Popen(command, env=environment) for command in commands]
        try:
            time.sleep(SETTLE_S)
            play = [
                "ros2",
                "bag",
                "play",
                "--storage",
                "mcap",
                "--clock",
                "200",
                "--rate",
                str(SPEED),
                dive,
            ]
            subprocess.run(play, env=environment, check=True)
            time.sleep(SETTLE_S)  # the last messages
        finally:
            stop(running)
        [recorded] = bag.glob("*.mcap")
        shutil.move(recorded, solution)


if __name__ == "__main__":
    main(*sys.argv[1:])
