# SPDX-License-Identifier: Apache-2.0
# One way to build the C++ cores: for pip (scikit-build-core), for colcon (ament_cmake), or their unit tests alone, which need
# neither Python nor ROS (-DSOFTGRIP_TESTS_ONLY=ON).

# softgrip_setup(): what every package with a core begins with, after project().
macro(softgrip_setup)
  option(SOFTGRIP_TESTS_ONLY "Build the unit tests of the C++ cores alone" OFF)
  set(CMAKE_CXX_STANDARD 17)
  set(CMAKE_CXX_STANDARD_REQUIRED ON)
  set(CMAKE_CXX_EXTENSIONS OFF)
  set(CMAKE_EXPORT_COMPILE_COMMANDS ON)
  if(NOT CMAKE_BUILD_TYPE)
    set(CMAKE_BUILD_TYPE Release)
  endif()
  find_package(Eigen3 REQUIRED)
  if(SOFTGRIP_TESTS_ONLY)
    set(BUILD_TESTING ON)
    enable_testing()
  else()
    if(NOT SKBUILD)
      find_package(ament_cmake REQUIRED)
      find_package(ament_cmake_python REQUIRED)
    endif()
    find_package(Python COMPONENTS Interpreter Development.Module REQUIRED)
    find_package(pybind11 CONFIG REQUIRED)
    # CMake's own way of it: GCC links with all processors, where what pybind11 gives it (-flto) uses one
    include(CheckIPOSupported)
    check_ipo_supported(RESULT CMAKE_INTERPROCEDURAL_OPTIMIZATION OUTPUT ipo_problem LANGUAGES CXX)
    if(SKBUILD)
      set(python_destination ${PROJECT_NAME})
    else()
      ament_python_install_package(${PROJECT_NAME} SETUP_CFG setup.cfg SCRIPTS_DESTINATION lib/${PROJECT_NAME})
      ament_get_python_install_dir(python_install_dir)
      set(python_destination ${python_install_dir}/${PROJECT_NAME})
    endif()
  endif()
endmacro()

# softgrip_core(<name> [SUBPACKAGE <subpackage>] BINDING <file> SOURCES <file>...): the private extension module
# <package>[.<subpackage>]._core. What the sources need is added to the interface library <name>_needs.
function(softgrip_core name)
  cmake_parse_arguments(core "" "SUBPACKAGE;BINDING" "SOURCES" ${ARGN})
  add_library(${name}_needs INTERFACE)
  target_include_directories(${name}_needs INTERFACE ${CMAKE_CURRENT_SOURCE_DIR}/include)
  target_link_libraries(${name}_needs INTERFACE Eigen3::Eigen)
  target_compile_options(${name}_needs INTERFACE -Wall -Wextra -fno-math-errno)
  set(${name}_sources ${core_SOURCES} PARENT_SCOPE)
  if(SOFTGRIP_TESTS_ONLY)
    # for clang-tidy, which wants to know how every source is compiled
    add_library(${name}_objects OBJECT EXCLUDE_FROM_ALL ${core_SOURCES})
    target_link_libraries(${name}_objects PRIVATE ${name}_needs)
    return()
  endif()
  pybind11_add_module(${name}_core ${core_BINDING} ${core_SOURCES})
  target_link_libraries(${name}_core PRIVATE ${name}_needs)
  set_target_properties(${name}_core PROPERTIES OUTPUT_NAME _core
    LIBRARY_OUTPUT_DIRECTORY ${CMAKE_CURRENT_BINARY_DIR}/${core_SUBPACKAGE})
  install(TARGETS ${name}_core LIBRARY DESTINATION ${python_destination}/${core_SUBPACKAGE})
endfunction()

# softgrip_core_tests(<name> <file>...): GoogleTest tests of a core, run by ctest and so by colcon test. The sources are compiled
# again for them, quickly and with Eigen's assertions.
function(softgrip_core_tests name)
  if(NOT BUILD_TESTING)
    return()
  endif()
  find_package(GTest REQUIRED)
  add_executable(${name}_tests ${${name}_sources} ${ARGN})
  target_link_libraries(${name}_tests PRIVATE ${name}_needs GTest::gtest_main)
  target_compile_options(${name}_tests PRIVATE -O1 -UNDEBUG)
  target_precompile_headers(${name}_tests PRIVATE <Eigen/Dense> <Eigen/Sparse> <gtest/gtest.h>)
  add_test(NAME ${name}_tests COMMAND ${name}_tests
    --gtest_output=xml:${CMAKE_CURRENT_BINARY_DIR}/test_results/${PROJECT_NAME}/${name}.gtest.xml)
endfunction()

# softgrip_finish([PYTEST]): what every package with a core ends with; colcon test runs the linters that package.xml names.
# PYTEST: it runs the package's test/ with pytest, too.
macro(softgrip_finish)
  if(NOT SKBUILD AND NOT SOFTGRIP_TESTS_ONLY)
    if(BUILD_TESTING)
      find_package(ament_lint_auto REQUIRED)
      ament_lint_auto_find_test_dependencies()
      if("${ARGN}" STREQUAL "PYTEST")
        find_package(ament_cmake_pytest REQUIRED)
        ament_add_pytest_test(pytest test TIMEOUT 600)
      endif()
    endif()
    ament_package()
  endif()
endmacro()
