#pragma once

namespace tagdock {

/// The Aravis client as a process of its own: does what it is asked through the socket, until it is told to end or the
/// socket is closed. Used as a program's whole main by `open_gige`.
/// @param socket  one end of a pair of SOCK_SEQPACKET
/// @return        the exit code
int serve_gige_client(int socket);

/// The word with which `open_gige` starts a program that shall do that.
constexpr const char* gige_client_word = "camera-client";

/// The exit code of a client that Aravis holds up.
constexpr int gige_client_stuck = 75;

/// The handle at which `open_gige` gives its end of the pair to the program that it starts.
constexpr int gige_client_socket = 3;

}  // namespace tagdock
