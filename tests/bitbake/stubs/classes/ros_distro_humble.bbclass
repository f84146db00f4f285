ROS_DISTRO = "humble"
inherit ros-distro-stub
