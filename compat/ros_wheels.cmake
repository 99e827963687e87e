# Lets an interface package build against the ROS wheels of a virtual environment. Given to CMake with
# -DCMAKE_PROJECT_INCLUDE; on a ROS 2 machine it is neither needed nor used.
#
# Python3_EXECUTABLE is the environment's Python; where nobody says so, that of the environment that is active, whatever
# Python colcon itself runs with.

if(NOT Python3_EXECUTABLE AND DEFINED ENV{VIRTUAL_ENV})
  set(Python3_EXECUTABLE "$ENV{VIRTUAL_ENV}/bin/python" CACHE FILEPATH "Python that has the packages")
endif()
execute_process(COMMAND "${Python3_EXECUTABLE}" -c "import sys; print(sys.prefix)"
  OUTPUT_VARIABLE environment OUTPUT_STRIP_TRAILING_WHITESPACE COMMAND_ERROR_IS_FATAL ANY)
list(APPEND CMAKE_PREFIX_PATH "${environment}")
set(ENV{AMENT_PREFIX_PATH} "$ENV{AMENT_PREFIX_PATH}:${environment}")

# Nobody asks for C++ on the wheels, whose client library is rclpy; it takes nearly half of a build.
find_package(ament_cmake_core REQUIRED)
macro(ament_register_extension point package file)
  if(NOT "${package}" MATCHES "^rosidl_.*_cpp$")
    list(APPEND AMENT_EXTENSIONS_${point} "${package}:${file}")
  endif()
endmacro()

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

# Nearly all build time goes into headers that each message's sources include again; compiling a target's sources
# together reads them once. Type descriptions clash with each other and stay apart.
function(compile_sources_together)
  get_property(targets DIRECTORY PROPERTY BUILDSYSTEM_TARGETS)
  foreach(target IN LISTS targets)
    if(target MATCHES "__rosidl_(typesupport_fastrtps_c|typesupport_introspection_c|typesupport_c|generator_c|generator_py)$")
      set_target_properties(${target} PROPERTIES UNITY_BUILD ON UNITY_BUILD_BATCH_SIZE 20)
      get_target_property(sources ${target} SOURCES)
      list(FILTER sources INCLUDE REGEX "__description\\.c$")
      set_source_files_properties(${sources} PROPERTIES SKIP_UNITY_BUILD_INCLUSION ON)
    endif()
  endforeach()
endfunction()
cmake_language(DEFER CALL compile_sources_together)
