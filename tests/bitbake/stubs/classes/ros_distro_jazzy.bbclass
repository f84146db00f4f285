ROS_DISTRO = "jazzy"
inherit ros-distro-stub
