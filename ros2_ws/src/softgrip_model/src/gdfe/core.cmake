# SPDX-License-Identifier: Apache-2.0
# SIMD with dispatch at run time: the system's Highway, else its sources, since rosdistro has no key for it
find_package(hwy 1.0 QUIET)
if(NOT hwy_FOUND)
  message(STATUS "Highway not found (apt-get install libhwy-dev): its sources are built")
  if(POLICY CMP0135)
    cmake_policy(SET CMP0135 NEW)
  endif()
  set(CMAKE_POLICY_DEFAULT_CMP0077 NEW)  # what is set here and in softgrip_setup holds in its CMakeLists, too
  if(NOT DEFINED BUILD_TESTING)
    set(BUILD_TESTING OFF)
  endif()
  foreach(unused CONTRIB EXAMPLES INSTALL TESTS)
    set(HWY_ENABLE_${unused} OFF CACHE BOOL "" FORCE)
  endforeach()
  set(HWY_FORCE_STATIC_LIBS ON)
  include(FetchContent)
  FetchContent_Declare(highway URL https://github.com/google/highway/archive/refs/tags/1.0.7.tar.gz
    URL_HASH SHA256=5434488108186c170a5e2fca5e3c9b6ef59a1caa4d520b008a9b8be6b8abe6c5)  # as in Ubuntu 24.04
  FetchContent_MakeAvailable(highway)
  add_library(hwy::hwy ALIAS hwy)
  set_target_properties(hwy PROPERTIES POSITION_INDEPENDENT_CODE ON)
endif()
softgrip_core(gdfe SUBPACKAGE gdfe BINDING src/gdfe/binding.cpp
  SOURCES src/gdfe/aggregation.cpp src/gdfe/anderson.cpp src/gdfe/anderson_passes.cpp src/gdfe/assembly.cpp
  src/gdfe/blocked_rows.cpp src/gdfe/cable.cpp src/gdfe/cable_system.cpp src/gdfe/contact.cpp src/gdfe/element_blocks.cpp
  src/gdfe/element_forces.cpp src/gdfe/factor.cpp src/gdfe/follower.cpp src/gdfe/force_assembly.cpp src/gdfe/inverted.cpp
  src/gdfe/local_step.cpp
  src/gdfe/mesh.cpp src/gdfe/multigrid.cpp src/gdfe/multigrid_cycle.cpp src/gdfe/node_rows.cpp src/gdfe/ogden.cpp
  src/gdfe/ordering.cpp src/gdfe/panel_cholesky.cpp src/gdfe/panel_factor.cpp src/gdfe/panel_solve.cpp src/gdfe/preconditioner.cpp
  src/gdfe/section_level.cpp src/gdfe/sections.cpp src/gdfe/simd.cpp src/gdfe/solver.cpp src/gdfe/stream.cpp
  src/gdfe/tangent.cpp src/gdfe/unknowns.cpp)
# Highway compiles a file again for every instruction set: it includes it by its path in the package
target_include_directories(gdfe_needs INTERFACE ${CMAKE_CURRENT_SOURCE_DIR})
target_link_libraries(gdfe_needs INTERFACE hwy::hwy)

# Vectors are kept in arrays: not possible with the sizeless types of SVE and RVV, which run NEON or scalar code.
set(disabled_simd HWY_SVE HWY_SVE2 HWY_SVE_256 HWY_SVE2_128 HWY_RVV)
# On x86 SSE2, AVX2 and AVX-512: what lies between has the same doubles in a register, and each takes as long to compile. The bits are
# HWY_AVX3_SPR and HWY_AVX3_ZEN4, which Highway 1.0.3 has not got yet.
list(APPEND disabled_simd HWY_SSSE3 HWY_SSE4 HWY_AVX3_DL "(1LL<<4)" "(1LL<<6)")
list(JOIN disabled_simd "|" disabled_simd)
target_compile_definitions(gdfe_needs INTERFACE "HWY_DISABLED_TARGETS=(${disabled_simd})")

# Eigen's own threads would keep every processor busy in the set-up, whatever Settings.threads says.
target_compile_definitions(gdfe_needs INTERFACE EIGEN_DONT_PARALLELIZE)

find_package(OpenMP COMPONENTS CXX)
if(OpenMP_CXX_FOUND)
  target_link_libraries(gdfe_needs INTERFACE OpenMP::OpenMP_CXX)
else()
  message(STATUS "OpenMP not found: the GDFE core runs on one thread")
endif()

# Ordering of large matrices; without it AMD orders them all: larger factors above some 5,000 hexahedra.
find_library(METIS_LIBRARY metis)
find_path(METIS_INCLUDE_DIR metis.h)
if(METIS_LIBRARY AND METIS_INCLUDE_DIR)
  target_compile_definitions(gdfe_needs INTERFACE SOFTGRIP_HAVE_METIS)
  target_include_directories(gdfe_needs INTERFACE ${METIS_INCLUDE_DIR})
  target_link_libraries(gdfe_needs INTERFACE ${METIS_LIBRARY})
else()
  message(STATUS "METIS not found (apt-get install libmetis-dev): large GDFE meshes are ordered by AMD")
endif()

softgrip_core_tests(gdfe test/cpp/gdfe/test_anderson.cpp test/cpp/gdfe/test_cable.cpp test/cpp/gdfe/test_contact.cpp
  test/cpp/gdfe/test_factor.cpp test/cpp/gdfe/test_local_step.cpp test/cpp/gdfe/test_multigrid.cpp
  test/cpp/gdfe/test_sections.cpp test/cpp/gdfe/test_solver.cpp test/cpp/gdfe/test_tangent.cpp)
if(TARGET gdfe_tests)
  # one instruction set: test/test_gdfe_simd.py compares all
  target_compile_definitions(gdfe_tests PRIVATE HWY_COMPILE_ONLY_STATIC)
endif()
