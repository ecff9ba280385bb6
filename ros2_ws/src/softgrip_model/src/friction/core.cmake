# SPDX-License-Identifier: Apache-2.0
softgrip_core(friction SUBPACKAGE friction BINDING src/friction/binding.cpp SOURCES src/friction/fit.cpp)
