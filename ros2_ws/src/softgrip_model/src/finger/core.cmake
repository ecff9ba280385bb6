# SPDX-License-Identifier: Apache-2.0
find_package(Threads REQUIRED)
softgrip_core(finger SUBPACKAGE finger BINDING src/finger/binding.cpp
  SOURCES src/finger/batch.cpp src/finger/path.cpp src/finger/path_system.cpp)
# lanes in registers that not every processor has are never passed between functions that are not inlined
target_compile_options(finger_needs INTERFACE -Wno-psabi)
target_link_libraries(finger_needs INTERFACE Threads::Threads)
softgrip_core_tests(finger test/cpp/finger/test_finger_kernel.cpp test/cpp/finger/test_friction.cpp)
