# The class of 2014: programs below /usr.
ROS_BPN = "${@d.getVar('BPN').replace('-', '_')}"
catkin_prefix = "/usr"
inherit catkin-stub
