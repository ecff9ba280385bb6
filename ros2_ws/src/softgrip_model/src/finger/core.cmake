# SPDX-License-Identifier: Apache-2.0
find_package(Threads REQUIRED)
softgrip_core(finger src/finger/binding.cpp src/finger/batch.cpp src/finger/path.cpp)
# lanes in registers that not every processor has are never passed between functions that are not inlined
target_compile_options(finger_core PRIVATE -Wno-psabi)
target_link_libraries(finger_core PRIVATE Threads::Threads)
