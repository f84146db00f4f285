stub_prefix = "${ros_prefix}"
inherit cmake-stub
EXTRA_OECMAKE += "-DCATKIN_BUILD_BINARY_PACKAGE=ON -DCATKIN_ENABLE_TESTING=0"
