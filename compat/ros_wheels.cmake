# Lets an interface package build against the ROS wheels of a virtual environment. Given to CMake with
# -DCMAKE_PROJECT_INCLUDE; on a ROS 2 machine it is neither needed nor used.
#
# Expects Python3_EXECUTABLE and CMAKE_INSTALL_PREFIX to be the environment's.

list(PREPEND CMAKE_PREFIX_PATH "${CMAKE_INSTALL_PREFIX}")
set(ENV{AMENT_PREFIX_PATH} "${CMAKE_INSTALL_PREFIX}")

# The wheels' exported targets name the Python headers of the machine that built them (/opt/python/...), and
# CMake refuses imported targets whose include directories do not exist. Drop those once all are imported.
function(drop_missing_include_directories)
  get_property(targets DIRECTORY PROPERTY IMPORTED_TARGETS)
  foreach(target IN LISTS targets)
    get_target_property(directories ${target} INTERFACE_INCLUDE_DIRECTORIES)
    if(NOT directories)
      continue()
    endif()
    set(present "")
    foreach(directory IN LISTS directories)
      if(NOT directory MATCHES "^/opt/python/" OR EXISTS "${directory}")
        list(APPEND present "${directory}")
      endif()
    endforeach()
    set_property(TARGET ${target} PROPERTY INTERFACE_INCLUDE_DIRECTORIES "${present}")
  endforeach()
endfunction()
cmake_language(DEFER CALL drop_missing_include_directories)
