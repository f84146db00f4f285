ROS_DISTRO = "lyrical"
inherit ros-distro-stub
