ROS_BPN ??= "${@d.getVar('BPN').replace('-', '_')}"
