# ViSP's modules as targets ViSP::core, ViSP::vs and so on. Its own package file also looks for every optional library
# that it was built with (VTK, Coin, OGRE ...), which tagdock does not use; the modules are found by name instead.
find_path(VISP_INCLUDE_DIR visp3/core/vpConfig.h REQUIRED)

# ViSP 3.5 names the constructors of vpArray2D as template-ids (`vpArray2D<Type>()`), which C++20 forbids (CWG 2237) and
# g++ refuses. A copy of that one header with the plain names comes first on the include path.
file(READ ${VISP_INCLUDE_DIR}/visp3/core/vpArray2D.h header)
string(REPLACE "vpArray2D<Type>(" "vpArray2D(" header "${header}")
file(CONFIGURE OUTPUT ${PROJECT_BINARY_DIR}/visp_cxx20/visp3/core/vpArray2D.h CONTENT "${header}" @ONLY)

foreach(module core vision visual_features vs detection gui io)
  find_library(VISP_${module}_LIBRARY visp_${module} REQUIRED)
  add_library(ViSP::${module} INTERFACE IMPORTED)
  target_include_directories(ViSP::${module} SYSTEM BEFORE INTERFACE ${PROJECT_BINARY_DIR}/visp_cxx20)
  target_include_directories(ViSP::${module} SYSTEM INTERFACE ${VISP_INCLUDE_DIR} ${OpenCV_INCLUDE_DIRS})
  target_link_libraries(ViSP::${module} INTERFACE ${VISP_${module}_LIBRARY})
  if(NOT module STREQUAL core)
    target_link_libraries(ViSP::${module} INTERFACE ViSP::core)
  endif()
endforeach()
