# The library's sources, relative to this folder; the unit tests compile the same list.
set(rt_tests_support_SOURCES
  ${CMAKE_CURRENT_LIST_DIR}/src/background.cpp
  ${CMAKE_CURRENT_LIST_DIR}/src/blocks.cpp
  ${CMAKE_CURRENT_LIST_DIR}/src/clock.cpp
  ${CMAKE_CURRENT_LIST_DIR}/src/errors.cpp
  ${CMAKE_CURRENT_LIST_DIR}/src/files.cpp
  ${CMAKE_CURRENT_LIST_DIR}/src/json.cpp
  ${CMAKE_CURRENT_LIST_DIR}/src/log.cpp
  ${CMAKE_CURRENT_LIST_DIR}/src/options.cpp
  ${CMAKE_CURRENT_LIST_DIR}/src/process.cpp
  ${CMAKE_CURRENT_LIST_DIR}/src/programs.cpp
  ${CMAKE_CURRENT_LIST_DIR}/src/report.cpp
  ${CMAKE_CURRENT_LIST_DIR}/src/stop.cpp
  ${CMAKE_CURRENT_LIST_DIR}/src/summary.cpp
  ${CMAKE_CURRENT_LIST_DIR}/src/trace.cpp
)
