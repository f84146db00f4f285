// What rcl and rclcpp have in common: what is in effect below them, and the message of communication_tests.
#pragma once

#include <link.h>
#include <rcl/context.h>
#include <rmw/rmw.h>

#include <cstdint>
#include <cstdlib>
#include <fstream>
#include <string>

#include "rt_tests_support/middleware.h"

namespace rt_tests {

// The file of a library that is loaded, by its name without folder; empty: it is not.
inline std::string loaded_library(const std::string& name) {
  struct Search {
    std::string end, path;
  } search{"/" + name, ""};
  const auto visit = [](dl_phdr_info* library, std::size_t, void* data) {
    auto& [end, path] = *static_cast<Search*>(data);
    const std::string file = library->dlpi_name;
    if (file.size() < end.size() || file.compare(file.size() - end.size(), end.size(), end) != 0) return 0;
    path = file;
    return 1;
  };
  dl_iterate_phdr(visit, &search);
  return search.path;
}

// The version of a package of ROS 2 whose library lib<package>.so is loaded: its package.xml is in ../share/<package>.
inline std::string loaded_version(const std::string& package) {
  const std::string library = loaded_library("lib" + package + ".so");
  std::ifstream xml(library.substr(0, library.rfind('/')) + "/../share/" + package + "/package.xml");
  for (std::string line; std::getline(xml, line);) {
    const std::size_t begin = line.find("<version>"), end = line.find("</version>");
    if (begin != std::string::npos && end != std::string::npos) return line.substr(begin + 9, end - begin - 9);
  }
  return "";
}

// The RMW in effect, whatever RMW_IMPLEMENTATION says.
inline Facts ros2_facts(rcl_context_t& context) {
  const char* distro = std::getenv("ROS_DISTRO");
  const std::string rmw = rmw_get_implementation_identifier();
  std::size_t domain_id = 0;
  const bool has_domain = rcl_context_get_domain_id(&context, &domain_id) == RCL_RET_OK;
  return {{"ros_distro", distro ? distro : ""},
          {"rcl_version", loaded_version("rcl")},
          {"rmw", rmw},
          {"rmw_version", loaded_version(rmw)},
          {"domain_id", has_domain ? std::to_string(domain_id) : ""}};
}

}  // namespace rt_tests
