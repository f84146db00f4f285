stub_prefix = "${ros_prefix}"
inherit cmake-stub
