#!/bin/bash
set -e
source /opt/ros/jazzy/setup.bash
source /softgrip/ros2_ws/install/setup.bash
exec "$@"
