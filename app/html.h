#pragma once

#include <string>

namespace tagdock {

/// Begins a page of its own: no scripts, nothing from elsewhere. Ends with "</body></html>\n".
std::string html_head(const std::string& title);

/// Text as it stands in a page or an SVG picture, also between quotes.
std::string html_text(const std::string& text);

}  // namespace tagdock
