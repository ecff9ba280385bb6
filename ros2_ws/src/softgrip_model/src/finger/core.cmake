# SPDX-License-Identifier: Apache-2.0
find_package(Threads REQUIRED)
softgrip_core(finger src/finger/binding.cpp src/finger/batch.cpp src/finger/path.cpp)
target_link_libraries(finger_core PRIVATE Threads::Threads)
