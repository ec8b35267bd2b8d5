# Cyclone DDS with the messages of ROS 2, as tagdock_ros2_messages; not there when Cyclone or its idlc is not installed.
find_package(CycloneDDS QUIET)
find_program(TAGDOCK_IDLC idlc)
if(CycloneDDS_FOUND AND TAGDOCK_IDLC)
  enable_language(C) # what idlc writes
  set(generated ${PROJECT_BINARY_DIR}/ros2_messages)
  set(idl ${PROJECT_SOURCE_DIR}/app/robots/ros2/ros2_messages.idl)
  file(MAKE_DIRECTORY ${generated})
  add_custom_command(OUTPUT ${generated}/ros2_messages.c ${generated}/ros2_messages.h
    # Final types without type information: as ROS 2's own middleware sends them.
    COMMAND ${TAGDOCK_IDLC} -t -x final -o ${generated} ${idl}
    DEPENDS ${idl} VERBATIM)
  add_library(tagdock_ros2_messages STATIC ${generated}/ros2_messages.c ${generated}/ros2_messages.h)
  target_include_directories(tagdock_ros2_messages SYSTEM PUBLIC ${generated})
  target_link_libraries(tagdock_ros2_messages PUBLIC CycloneDDS::ddsc)
  message(STATUS "Cyclone DDS: ${CycloneDDS_VERSION}")
else()
  message(WARNING "Cyclone DDS not found: a robot cannot be driven by ROS 2 topics by this build")
endif()
