ROS_DISTRO = "noetic"
inherit ros-distro-stub
