catkin_prefix = "${ros_prefix}"
inherit catkin-stub
