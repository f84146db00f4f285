# The class of 2014: programs below /usr.
ROS_BPN = "${@d.getVar('BPN').replace('-', '_')}"
stub_prefix = "/usr"
inherit cmake-stub
